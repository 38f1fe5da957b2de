"""Hard cases of weights in safetensors: decoders and detectors."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from typing import Any

import torch
from catalogue import hard_case
from clear_errors import harmful, place, refused
from random_networks import SLIM, random_net
from safetensors.torch import load_file, save_file
from valid_weights import DECODER, SMALL, write_decoder

from shift3d.detectors.models.network import DetectorNet
from shift3d.detectors.models.pillar_detectors import PointPillarsNet
from shift3d.detectors.models.weights import load_weights
from shift3d.sdf.decoder import Decoder, load_decoder, save_decoder

AREA = "checkpoints"
Tensors = dict[str, Any]


def decoder_after(change: Callable[[Tensors], object], architecture: dict[str, int] | None = None) -> Decoder:
    """Load the small decoder after a change of its file's tensors, and of the architecture that the file states."""
    with place() as folder:
        write_decoder(folder)
        tensors = load_file(folder / DECODER)
        change(tensors)
        metadata = {"architecture": json.dumps({**vars(SMALL), **(architecture or {})})}
        save_file(tensors, folder / DECODER, metadata=metadata)
        return load_decoder(folder / DECODER)


def detector_after(change: Callable[[Tensors], object]) -> DetectorNet:
    with place() as folder:
        tensors = {name: value.clone() for name, value in random_net("pointpillars").state_dict().items()}
        change(tensors)
        save_file(tensors, folder / "net.safetensors")
        return load_weights(PointPillarsNet(SLIM["pointpillars"]), folder / "net.safetensors")  # type: ignore[arg-type]


def put(name: str, value: Callable[[torch.Tensor], torch.Tensor]) -> Callable[[Tensors], None]:
    return lambda tensors: tensors.update({name: value(tensors[name])})


def with_first(value: float) -> Callable[[torch.Tensor], torch.Tensor]:
    """Return a change that copies a tensor and replaces its first value."""

    def change(tensor: torch.Tensor) -> torch.Tensor:
        changed = tensor.clone()
        changed.view(-1)[0] = value
        return changed

    return change


@hard_case(
    area=AREA,
    why="tensors under other names leave a network at its random start",
    must="an error that names the file and the tensor that belongs elsewhere",
    guard="names that the network does not have are refused",
)
def a_decoder_with_tensors_of_another_network() -> None:
    refused(lambda: decoder_after(lambda t: t.update({"encoder.weight": t.pop("layers.1.bias")})), "encoder.weight")


@hard_case(
    area=AREA,
    why="a tensor of another shape may still be broadcast",
    must="an error that names the tensor and both shapes",
    guard="shapes are compared with the architecture's",
)
def a_decoder_with_a_tensor_of_another_shape() -> None:
    refused(
        lambda: decoder_after(put("layers.1.weight", lambda w: w[:1].clone())), "layers.1.weight", "(1, 16)", "(9, 16)"
    )


@hard_case(
    area=AREA,
    why="one NaN spreads to every value of the field; a float64 of 1e300 is infinite in float32",
    must="an error that names the file and the tensor",
    guard="tensors must be finite after they were cast",
)
def a_decoder_with_a_value_that_is_not_finite() -> None:
    for spoil in (with_first(torch.nan), with_first(-torch.inf), lambda w: w.double() * 1e300):
        refused(lambda s=spoil: decoder_after(put("layers.2.weight", s)), DECODER, "layers.2.weight", "not finite")


@hard_case(
    area=AREA,
    why="quantised weights are integers, and would be taken for weights of some hundreds",
    must="an error that names the tensor and its type; half precision is taken, and is float32 afterwards",
    guard="tensors must be dense floating-point numbers",
)
def a_decoder_with_integer_weights() -> None:
    refused(
        lambda: decoder_after(put("layers.0.weight", lambda w: (w * 127).to(torch.int8))), "layers.0.weight", "int8"
    )
    halved = decoder_after(put("layers.0.weight", torch.Tensor.half))
    assert all(parameter.dtype == torch.float32 for parameter in halved.parameters())


@hard_case(
    area=AREA,
    why="finite weights whose products are not: infinity less infinity is NaN",
    must="an error that names the file and the layer",
    guard="the largest value that a layer can reach is bounded, layer by layer, in float64",
)
def a_decoder_whose_values_would_overflow() -> None:
    def spoil(tensors: Tensors) -> None:
        for layer in (0, 1):
            tensors[f"layers.{layer}.weight"] *= 1e25

    refused(lambda: decoder_after(spoil), DECODER, "overflow")


@hard_case(
    area=AREA,
    why="a file of a kilobyte says that its network is a million wide: four terabytes",
    must="an error that names the file, before anything of that size is made",
    guard="shapes are compared before the network is built",
)
def a_decoder_that_claims_to_be_a_million_wide() -> None:
    refused(lambda: decoder_after(lambda t: None, {"width": 10**6}), DECODER, "layers.0.weight")


@hard_case(
    area=AREA,
    why="sizes that no network has: no layer to feed the input to, half a unit, true",
    must="an error that names the file",
    guard="an architecture must be one of whole numbers with room for its skip",
)
def a_decoder_with_an_architecture_that_cannot_be() -> None:
    skips = [{"skip_layer": layer} for layer in (0, 3, 4)]  # 3: the output layer
    for wrong in (*skips, {"width": 16.0}, {"code_length": True}, {"width": 6}):
        refused(lambda wrong=wrong: decoder_after(lambda t: None, wrong), DECODER, "made like")


@hard_case(
    area=AREA,
    why="a copy that ended early, a header with an absurd length, a pickle: what the library says of each differs",
    must="an error that names the file, and nothing unpickled",
    guard="errors of the safetensors library become ours",
)
def a_decoder_that_is_no_safetensors_file() -> None:
    with place() as folder:
        write_decoder(folder)
        path, marker = folder / DECODER, folder / "marker"
        whole = path.read_bytes()
        for content in (whole[:-5], whole[:100], b"", struct.pack("<Q", 2**63 - 1) + whole[8:], harmful(marker)):
            path.write_bytes(content)
            refused(lambda: load_decoder(path), DECODER)
        assert not marker.exists()


@hard_case(
    area=AREA,
    why="weight norm leaves subnormal values in units that died, and products with them take a hundred times as long",
    must="they are zero in the decoder and in its file",
    guard="values below 1e-20 become zero where tensors are read and written",
)
def weights_that_are_subnormal_numbers() -> None:
    decoder = decoder_after(put("layers.1.weight", with_first(1e-42)))
    weight = decoder.layers[1].weight
    assert isinstance(weight, torch.Tensor) and weight.view(-1)[0] == 0.0 and (weight.view(-1)[1:] != 0.0).any()
    with place() as folder:
        with torch.no_grad():
            weight.view(-1)[0] = 1e-39
        save_decoder(decoder, folder / DECODER)
        assert load_file(folder / DECODER)["layers.1.weight"].view(-1)[0] == 0.0


@hard_case(
    area=AREA,
    why="the root of a negative variance is NaN, and folded into the layer before it, so is every score",
    must="an error that names the tensor",
    guard="variances must not be negative",
)
def a_detector_with_a_negative_variance() -> None:
    name = "pillar_net.norm.running_var"
    refused(lambda: detector_after(put(name, with_first(-0.5))), "net.safetensors", name, "variance")


@hard_case(
    area=AREA,
    why="one flipped bit of an exponent makes 1e38 of a weight: finite, and the scores are not",
    must="an error that names the tensor; as for NaN",
    guard="no trained weight is beyond a million, and NaN is not below it",
)
def a_detector_with_one_flipped_bit() -> None:
    name = "backbone.blocks.0.0.weight"
    for value in (-2e38, torch.nan, torch.inf):
        refused(lambda value=value: detector_after(put(name, with_first(value))), "net.safetensors", name)


@hard_case(
    area=AREA,
    why="integers where floating-point numbers were trained are copied without a word, all zero",
    must="an error that names the tensor and its type",
    guard="kinds of numbers are compared",
)
def a_detector_with_integer_weights() -> None:
    name = "heads.classes.weight"
    refused(lambda: detector_after(put(name, torch.Tensor.int)), "net.safetensors", name, "int32")
    assert detector_after(put(name, torch.Tensor.double)).heads.classes.weight.dtype == torch.float32
