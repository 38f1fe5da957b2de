"""The decoder: the published network, its folded field, its file."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from shift3d.errors import InputError
from shift3d.sdf.decoder import Architecture, Decoder, decoder_from_tensors, load_decoder, save_decoder

SMALL = Architecture(code_length=5, width=24, hidden_layers=8, skip_layer=4)


def small(seed: int = 0) -> Decoder:
    torch.manual_seed(seed)
    return Decoder(SMALL)


def test_published_sizes() -> None:
    specs = Architecture().specs()
    sizes = [specs.size(layer) for layer in range(specs.layers)]
    assert sizes[0] == (259, 512)
    assert sizes[3] == (512, 253)
    assert sizes[4] == (512, 512)
    assert sizes[8] == (512, 1)
    assert len(sizes) == 9


def test_field_grouped_and_plain_evaluation_agree() -> None:
    decoder = small().double()
    codes, points = torch.randn(3, 5, dtype=torch.float64), torch.randn(3, 7, 3, dtype=torch.float64)
    plain = torch.stack([decoder(codes[i].expand(7, -1), points[i]) for i in range(3)])
    grouped = decoder.grouped(codes, points, torch.float64)
    fields = torch.stack([decoder.field(codes[i])(points[i]) for i in range(3)])
    assert torch.allclose(plain, grouped, atol=1e-14)
    assert torch.allclose(plain, fields, atol=1e-14)
    assert torch.allclose(plain, torch.stack([decoder.folded().field(c)(p) for c, p in zip(codes, points)]), atol=1e-14)


def test_field_is_differentiable_in_points_and_code() -> None:
    decoder = small(1).double().folded().requires_grad_(False)
    z = torch.randn(5, dtype=torch.float64, requires_grad=True)
    x = torch.randn(4, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda z, x: decoder.field(z)(x), (z, x))


def test_detached_field_has_the_same_values_and_no_graph_to_z() -> None:
    decoder = small(2)
    z = torch.randn(5, requires_grad=True)
    x = torch.randn(4, 3)
    field = decoder.field(z)
    assert field(x).requires_grad
    assert not field.detach()(x).requires_grad
    assert torch.equal(field(x), field.detach()(x))


def test_code_of_another_length_or_not_finite_is_refused() -> None:
    with pytest.raises(InputError, match="latent code"):
        small().field(torch.zeros(6))
    with pytest.raises(InputError, match="finite"):
        small().field(torch.full((5,), float("nan")))


def test_file_round_trip(tmp_path: Path) -> None:
    decoder = small(3)
    save_decoder(decoder, tmp_path / "d.safetensors")
    again = load_decoder(tmp_path / "d.safetensors")
    z, x = torch.randn(5), torch.randn(6, 3)
    assert torch.allclose(again.field(z)(x), decoder.field(z)(x), atol=1e-7)
    assert not any(p.requires_grad for p in again.parameters())
    assert again.architecture == SMALL


def test_files_that_are_no_decoder_say_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_decoder(tmp_path / "none.safetensors")
    save_decoder(small(), tmp_path / "d.safetensors")
    whole = (tmp_path / "d.safetensors").read_bytes()
    (tmp_path / "cut.safetensors").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"cut\.safetensors"):
        load_decoder(tmp_path / "cut.safetensors")
    tensors = dict(small().folded().state_dict())
    with pytest.raises(InputError, match=r"layers\.0\.weight"):
        decoder_from_tensors({**tensors, "layers.0.weight": torch.zeros(2, 2)}, SMALL, "here")
    with pytest.raises(InputError, match=r"layers\.8\.bias"):
        decoder_from_tensors({k: v for k, v in tensors.items() if k != "layers.8.bias"}, SMALL, "here")
