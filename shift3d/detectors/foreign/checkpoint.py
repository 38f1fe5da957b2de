"""Loading of OpenPCDet and mmdetection3d checkpoints: compares names and shapes of tensors with the config."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from shift3d.detectors.foreign.layout import Layout
from shift3d.detectors.foreign.network import ForeignNet
from shift3d.detectors.foreign.tensor_names import entries
from shift3d.detectors.models.weights import wrong_values
from shift3d.errors import InputError
from shift3d.wording import counted

_SHOWN = 3
_PLAIN = "Where it was trained, save the tensors alone: torch.save({'state_dict': model.state_dict()}, FILE)"
_STATES = ("model_state", "state_dict", "model_state_dict")
_COUNTERS = (".num_batches_tracked", "global_step")
_KINDS = (
    (("backbone_3d.",), "a model with a sparse 3D backbone (SECOND, PV-RCNN, VoxelNeXt)"),
    (("roi_head.", "point_head.", "rpn_head."), "a model with a second stage"),
    (("img_backbone.", "img_neck."), "a model of images, or of both sensors"),
    (("dense_head.rpn_heads.",), "OpenPCDet's AnchorHeadMulti"),
    (("pts_middle_encoder.", "middle_encoder."), "a model of mmdetection3d with a sparse or transformer encoder"),
    (("vfe.", "dense_head."), "a pillar model of OpenPCDet"),
    (("pts_bbox_head.", "bbox_head."), "a pillar model of mmdetection3d"),
    (("pillar_net.", "heads."), "weights of shift3d: detector=pointpillars or centerpoint"),
)


def load_foreign_net(path: Path, layout: Layout) -> ForeignNet:
    """Build the network of a layout with the tensors of a checkpoint, in evaluation mode.

    Raises: InputError with the file if it is unreadable or contains pickled objects; with the first tensors that are
        missing, surplus, of another shape, or contain values that no trained network has.
    """
    found = _tensors(path)
    wanted = {entry.name: entry for entry in entries(layout)}
    _compare({name: entry.shape for name, entry in wanted.items()}, found, path)
    net = ForeignNet(layout)
    expected = net.state_dict()
    state = {name: tensor for name, tensor in expected.items() if name.endswith(_COUNTERS)}
    for name, entry in wanted.items():
        value = found[name].detach()
        if wrong := wrong_values(name, value, torch.zeros(0)):
            raise InputError(f"tensor {name} {wrong}", str(path), "Copy it again")
        if entry.target is not None:
            picked = value if entry.pick is None else entry.pick(value)
            state[entry.target] = picked.to(expected[entry.target].dtype)
    net.load_state_dict(state)
    return net.eval()


def _tensors(path: Path) -> dict[str, Tensor]:
    """Return the model's tensors by name, without the data parallel prefix and without counters."""
    content = _content(path)
    states = [content[name] for name in _STATES if isinstance(content.get(name), Mapping)]
    state = states[0] if states else content
    _refuse_older(content, path)
    named = {str(name).removeprefix("module."): value for name, value in state.items()}
    tensors = {name: value for name, value in named.items() if isinstance(value, Tensor)}
    if not tensors:
        keys = ", ".join(sorted(map(str, content))[:_SHOWN])
        remedy = f"Save it under {' or '.join(_STATES[:2])}"
        raise InputError(f"holds no table of tensors, but {keys}", str(path), remedy)
    for name, value in tensors.items():
        if value.is_nested or value.is_meta or value.layout is not torch.strided:
            kind = "nested" if value.is_nested else "without values" if value.is_meta else value.layout
            raise InputError(f"tensor {name} is {kind}, not dense numbers", str(path), "Save it as dense float32")
    return {name: value for name, value in tensors.items() if not name.endswith(_COUNTERS)}


def _refuse_older(content: Mapping[str, Any], path: Path) -> None:
    """Refuse a checkpoint whose metadata name a release with other conventions for boxes and headings."""
    meta = content.get("meta")
    for codebase, version, older, covered in (
        ("mmdetection3d", meta.get("mmdet3d_version") if isinstance(meta, Mapping) else None, ("0.",), "1.x"),
        ("OpenPCDet", content.get("version"), ("pcdet+0.1", "pcdet+0.2"), "0.3 or later"),
    ):
        if isinstance(version, str) and version.startswith(older):
            what = f"is of {codebase} {version}, whose boxes and headings are others"
            raise InputError(what, str(path), f"Convert or train it with {covered}")


def _content(path: Path) -> Mapping[str, Any]:
    if not path.is_file():
        raise InputError("no such file", str(path), "Check detector.weights")
    try:
        with torch.serialization.safe_globals(list(_numpy_scalars())):
            content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a damaged pickle can raise almost any exception
        reason = next((line for line in str(error).splitlines() if "GLOBAL" in line or "global" in line), "")
        what = f"no readable checkpoint of tensors and plain values {reason[:160]}".rstrip()
        raise InputError(what, str(path), _PLAIN) from error
    if not isinstance(content, Mapping):
        raise InputError(f"holds a {type(content).__name__}, no table by name", str(path), "Give a checkpoint")
    return content


def _numpy_scalars() -> Iterator[Any]:
    """Yield the constructors of numpy scalars, which training loops store in checkpoints; they are plain data."""
    with contextlib.suppress(AttributeError):
        scalar = np._core.multiarray.scalar  # type: ignore[attr-defined]
        yield scalar
        yield (scalar, "numpy.core.multiarray.scalar")
    yield np.dtype
    for kind in ("Float64DType", "Float32DType", "Int64DType", "Int32DType", "BoolDType"):
        yield getattr(np.dtypes, kind)


def _compare(wanted: Mapping[str, tuple[int, ...]], found: Mapping[str, Tensor], path: Path) -> None:
    """Refuse missing, surplus and misshapen tensors with one error that lists all three."""
    missing, surplus = sorted(wanted.keys() - found.keys()), sorted(found.keys() - wanted.keys())
    shapes = {name: tuple(found[name].shape) for name in sorted(wanted.keys() & found.keys())}
    misshapen = [
        f"{name} is {shape}, the config asks for {wanted[name]}"
        for name, shape in shapes.items()
        if shape != wanted[name]
    ]
    if not (missing or surplus or misshapen):
        return
    problems = [
        f"{counted(len(names), 'tensor')} {how}: {', '.join(names[:_SHOWN])}{', ...' if len(names) > _SHOWN else ''}"
        for how, names in (("missing", missing), ("too many", surplus), ("of another shape", misshapen))
        if names
    ]
    like = _looks_like(found) if missing or surplus else ""
    remedy = "Give the config that it was trained with" + (f"; it looks like {like}" if like else "")
    raise InputError("; ".join(problems), str(path), remedy)


def _looks_like(found: Mapping[str, Tensor]) -> str:
    for beginnings, kind in _KINDS:
        if any(name.startswith(beginnings) for name in found):
            return kind
    return ""
