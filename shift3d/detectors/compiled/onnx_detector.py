"""Score-only detector (no gradient) from an ONNX file.

The file has one input: points (N, 3) float32, N free, in the network frame (x forward, y left, z up from the ground
below the sensor, metres). It has two named outputs, float32 or float64: ``boxes`` (A, 7) in that frame and ``scores``
(A,) in [0, 1], before or after suppression; A may vary between calls. The file is only data: ONNX Runtime gets its
bytes, but no custom operator library and no folder to load other files from.
"""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from shift3d.detectors.names import ONNX
from shift3d.detectors.scores_only import ScoresOnlyDetector
from shift3d.errors import InputError
from shift3d.store.user_cache import cache_file, cache_result, read_cached, source_digest

if TYPE_CHECKING:
    import onnxruntime

_GUIDE = "See docs/guides/detectors.md, An ONNX file"


class OnnxDetector(ScoresOnlyDetector):
    """ONNX session behind the `Detector` interface. The network gets the whole scene in every call.

    Args: session: of a file that `load_onnx` has checked. where: name of the file in error messages.

    Not differentiable. The same points give the same bytes: one thread, operators run sequentially.
    """

    def __init__(self, session: onnxruntime.InferenceSession, where: str) -> None:
        super().__init__(ONNX, where, "Put a Sigmoid before the output scores")
        self._session = session
        self._input = session.get_inputs()[0].name

    def answer(self, points: Tensor) -> tuple[NDArray[Any], NDArray[Any]]:
        """See `ScoresOnlyDetector`. Raises InputError if the model fails."""
        rows = points.numpy()
        try:
            boxes, scores = self._session.run(["boxes", "scores"], {self._input: np.ascontiguousarray(rows)})
        except Exception as error:  # errors of ONNX Runtime have no narrower base class
            raise InputError(f"it fails on {len(rows)} points: {_line(error)}", self.where, _GUIDE) from error
        if not (isinstance(boxes, np.ndarray) and isinstance(scores, np.ndarray)):
            raise InputError("boxes or scores are sparse tensors", self.where, _GUIDE)
        return boxes, scores


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
    detector = OnnxDetector(session, where)
    by = onnxruntime.__version__, source_digest("detectors/compiled", "detectors/scores_only.py")
    tried = cache_file("tried_onnx", hashlib.blake2b(content).digest(), *by)
    if read_cached(tried) is None:  # the test makes three full forward passes: 11 s for PointPillars
        detector.try_on_random_points()
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
    if outside := [tensor for tensor in _stored_tensors(model) if uses_external_data(tensor)]:
        what = f"{len(outside)} of its tensors are in another file, which neither travels nor is part of a task's id"
        remedy = "Join them: onnx.save_model(onnx.load(FILE), NEW_FILE, save_as_external_data=False)"
        raise InputError(what, where, remedy)


def _stored_tensors(message: Any) -> Iterator[Any]:
    """Yield every tensor within a message: in graphs, operators, functions and sparse tensors."""
    from google.protobuf.message import Message

    for field, value in message.ListFields():
        for part in [value] if isinstance(value, Message) else value if field.message_type else ():
            if field.message_type.name == "TensorProto":
                yield part
            else:
                yield from _stored_tensors(part)


def _check_interface(session: onnxruntime.InferenceSession, where: str) -> None:
    """Check names, types and ranks as far as the file declares them; `try_on_random_points` checks the rest."""
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


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:300]


def require_packages(*names: str) -> None:
    """Check that packages are installed. Raises InputError with the install command for a missing package."""
    for name in names:
        if importlib.util.find_spec(name) is None:
            raise InputError(f"the package {name} is not installed", "detector=onnx", "Run pip install 'shift3d[onnx]'")
