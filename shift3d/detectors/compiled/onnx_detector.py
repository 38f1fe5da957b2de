"""Score-only detector (no gradient) from an ONNX file.

The file has one input: points (N, 3) float32, N free, in the network frame (x forward, y left, z up from the ground
below the sensor, metres). It has two named outputs, float32 or float64: ``boxes`` (A, 7) in that frame and ``scores``
(A,) in [0, 1], before or after suppression; A may vary between calls. The file is only data: ONNX Runtime gets its
bytes, but no custom operator library and no folder to load other files from.
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.detectors.base import BevWindow, Proposals
from shift3d.detectors.names import ONNX
from shift3d.detectors.nms import NmsDetector
from shift3d.errors import InputError
from shift3d.store.user_cache import cache_file, cache_result, read_cached, source_digest

if TYPE_CHECKING:
    import onnxruntime

_GUIDE = "See docs/guides/detectors.md, An ONNX file"
_PROBE_POINTS = 2000
_SATURATED = 2.0**-24
"""Smallest distance of scores from 0 and 1, where logits are infinite; 1 minus this is the last float32 below 1."""


class OnnxDetector(NmsDetector):
    """ONNX session behind the `Detector` interface. The network gets the whole scene in every call.

    The cells of a window are squares of 1 m, and cell (0, 0) begins at the origin of the network frame. A window
    selects the boxes with centres in its core as proposals: a file without suppression outputs half a million boxes,
    and computing all their overlaps costs more than the network.

    Args: session: of a file that `load_onnx` has checked. where: name of the file in error messages.

    Not differentiable. The same points give the same bytes: one thread, operators run sequentially.
    """

    def __init__(self, session: onnxruntime.InferenceSession, where: str) -> None:
        self.name = ONNX
        self._session, self._where = session, where
        self._input = session.get_inputs()[0].name

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        """See `Detector`: the window applies to the centres of boxes."""
        (x0, num_x), (y0, num_y) = (
            (math.floor(centre - radius_m), math.ceil(centre + radius_m) - math.floor(centre - radius_m))
            for centre in centre_xy
        )
        return BevWindow(x0, y0, num_x, num_y, x0, y0, num_x, num_y)

    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        """See `Detector`; float64 logits, no gradient. Raises InputError if the model fails or its output is bad."""
        rows = points.detach().to(torch.float32).numpy()
        try:
            boxes, scores = self._session.run(["boxes", "scores"], {self._input: np.ascontiguousarray(rows)})
        except Exception as error:  # errors of ONNX Runtime have no narrower base class
            raise InputError(f"it fails on {len(rows)} points: {_line(error)}", self._where, _GUIDE) from error
        _check_answer(boxes, scores, self._where)
        kept = np.arange(len(scores)) if window is None else np.flatnonzero(_inside(boxes, window))
        logits = torch.logit(torch.from_numpy(scores[kept]).double(), eps=_SATURATED)
        return Proposals(torch.from_numpy(boxes[kept]).float(), logits, torch.from_numpy(kept))


def load_onnx(path: Path) -> OnnxDetector:
    """Load a detector from an ONNX file. Raises: InputError if the file is missing, or as `onnx_detector` does."""
    if not path.is_file():
        raise InputError("no such file", str(path), "Give detector.file=FILE.onnx")
    return onnx_detector(path.read_bytes(), str(path))


def onnx_detector(content: bytes, where: str) -> OnnxDetector:
    """Make a detector from the content of an ONNX file, and test it on random points.

    The test runs once per machine; the user's cache folder stores that the content passed.

    Raises InputError with the file if it is not ONNX, has data in other files, uses operators that ONNX Runtime lacks,
    has other inputs or outputs than the module docstring says, returns invalid scores, or differs between two calls; or
    if packages of the extra onnx are not installed.
    """
    require_packages("onnx", "onnxruntime")
    import onnxruntime

    _check_content(content, where)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.enable_cpu_mem_arena = False  # PointPillars: keeps 0.3 GB instead of 2.0, takes a fifth more time
    options.log_severity_level = 4  # errors are raised, not logged
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # errors of ONNX Runtime have no narrower base class
        raise InputError(f"ONNX Runtime does not take it: {_line(error)}", where, _GUIDE) from error
    _check_interface(session, where)
    detector, by = OnnxDetector(session, where), (onnxruntime.__version__, source_digest("detectors/compiled"))
    tried = cache_file("tried_onnx", hashlib.blake2b(content).digest(), *by)
    if read_cached(tried) is None:  # the test makes three full forward passes: 11 s for PointPillars
        _try(detector, where)
        cache_result(tried, where.encode())
    return detector


def _check_content(content: bytes, where: str) -> None:
    import onnx
    from google.protobuf.message import DecodeError
    from onnx.external_data_helper import uses_external_data

    try:
        model = onnx.load_from_string(content)
    except DecodeError as error:
        raise InputError("it is no ONNX file", where, "Copy or export it again") from error
    if not model.graph.node:
        raise InputError("it is no ONNX file, or one without operators", where, "Copy or export it again")
    if outside := [tensor for tensor in _tensors(model.graph) if uses_external_data(tensor)]:
        what = f"{len(outside)} of its tensors are in another file, which neither travels nor is part of a task's id"
        remedy = "Join them: onnx.save_model(onnx.load(FILE), NEW_FILE, save_as_external_data=False)"
        raise InputError(what, where, remedy)


def _tensors(graph: Any) -> list[Any]:
    """Return all constants of a graph and of the graphs inside its operators."""
    found = list(graph.initializer)
    for attribute in (attribute for node in graph.node for attribute in node.attribute):
        found += [attribute.t, *attribute.tensors]
        for inner in (attribute.g, *attribute.graphs):
            found += _tensors(inner)
    return found


def _check_interface(session: onnxruntime.InferenceSession, where: str) -> None:
    """Check names, types and ranks as far as the file declares them; `_try` checks the rest."""
    inputs = session.get_inputs()
    if len(inputs) != 1:
        raise InputError(f"it has the inputs {[part.name for part in inputs]}, not the points alone", where, _GUIDE)
    points = inputs[0]
    rows = [size if isinstance(size, int) else None for size in points.shape]  # a name or None: any size
    if points.type != "tensor(float)" or rows not in ([None, 3], [None, None]):
        what = f"its input {points.name} is {points.type} {points.shape}, not tensor(float) (N, 3) with N free"
        raise InputError(what, where, _GUIDE)
    outputs = {part.name: part.type for part in session.get_outputs()}
    for name in ("boxes", "scores"):
        if outputs.get(name) not in ("tensor(float)", "tensor(double)"):
            what = f"its outputs are {outputs}, not boxes (A, 7) and scores (A,) of float32 or float64"
            raise InputError(what, where, _GUIDE)


def _try(detector: OnnxDetector, where: str) -> None:
    """Run the detector on two numbers of points, and twice on the same points."""
    reach, corner = torch.tensor([80.0, 80.0, 3.0]), torch.tensor([40.0, 40.0, 0.0])
    points = torch.rand(_PROBE_POINTS, 3, generator=torch.Generator().manual_seed(0)) * reach - corner
    first, second = detector.proposals(points), detector.proposals(points)
    if not torch.equal(first.logits, second.logits) or not torch.equal(first.boxes, second.boxes):
        raise InputError("two calls with the same points differ", where, "Leave random operators out")
    detector.proposals(points[: _PROBE_POINTS // 2])


def _inside(boxes: NDArray[Any], window: BevWindow) -> NDArray[np.bool_]:
    """Return the mask (A,) bool of boxes with their centre in the window's core."""
    x, y = boxes[:, 0] - window.core_x0, boxes[:, 1] - window.core_y0
    return (x >= 0) & (x < window.core_num_x) & (y >= 0) & (y < window.core_num_y)


def _check_answer(boxes: NDArray[Any], scores: NDArray[Any], where: str) -> None:
    if boxes.ndim != 2 or boxes.shape[1] != 7 or scores.shape != boxes.shape[:1]:
        what = f"its answer is boxes {boxes.shape} and scores {scores.shape}, not (A, 7) and (A,)"
        raise InputError(what, where, _GUIDE)
    if not np.isfinite(boxes).all() or not np.isfinite(scores).all():
        raise InputError("NaN or infinity in its answer", where, "Repair the model")
    if len(scores) and not (scores.min() >= 0.0 and scores.max() <= 1.0):
        what = f"its scores reach from {scores.min():g} to {scores.max():g}, not within [0, 1]"
        raise InputError(what, where, "Put a Sigmoid before the output scores")
    if (boxes[:, 3:6] <= 0).any():
        raise InputError("boxes without a size in its answer", where, _GUIDE)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:300]


def require_packages(*names: str) -> None:
    """Check that packages are installed. Raises InputError with the install command for a missing package."""
    for name in names:
        if importlib.util.find_spec(name) is None:
            raise InputError(f"the package {name} is not installed", "detector=onnx", "Run pip install 'shift3d[onnx]'")
