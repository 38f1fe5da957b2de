"""The user's own detector, loaded from a Python file that the settings name.

The file defines a function ``load(weights)``. It takes the path of a weight file, or None, and returns a function or
module that maps points (N, 3) to torch tensors, boxes (A, 7) and logits (A,); or to numpy arrays, boxes (A, 7) and
scores (A,), which have no gradient. docs/guides/detectors.md has examples. shift3d imports the file, so its code runs
with the rights of the user who starts the sweep. No other file named in the settings is executed.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.machinery
import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow, Proposals
from shift3d.detectors.models.network import Precision
from shift3d.detectors.names import OWN
from shift3d.detectors.nms import NmsDetector
from shift3d.detectors.scores_only import ScoresOnlyDetector, probe_points
from shift3d.errors import InputError

Model = Callable[[Tensor], Any]

_WHOLE = BevWindow(0, 0, 1, 1, 0, 0, 1, 1)
_GUIDE = "See docs/guides/detectors.md"
_ALONE = "Install the library; what lies in a file beside it belongs into the file itself"


class UserDetector(NmsDetector):
    """Model of points (N, 3) behind the `Detector` interface. The model gets the whole scene in every call.

    Args:
        model: maps points (N, 3), network frame (x forward, y left, z up from the ground below the sensor, metres), to
            boxes (A, 7) (x, y, z of the centre, dx, dy, dz, heading) in that frame and logits (A,) of a vehicle in each
            box. A is the same for any points; the logits are differentiable w.r.t. the points.
        where: name of the file in error messages.
        dtype: of the points that the model gets.

    Differentiable w.r.t. points, through the logits; boxes are detached.
    """

    def __init__(self, model: Model, where: str, dtype: torch.dtype = torch.float32) -> None:
        self.name = OWN
        self._model, self._where, self._dtype = model, where, dtype

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        """See `Detector`: every call returns the same window of one cell, the whole scene."""
        return _WHOLE

    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        """See `Detector`. Raises InputError if the model does not return boxes and logits, or returns NaN."""
        with _clear_errors(self._where):
            # A copy: a model that moves its points in place must not move those of the scene.
            answer = self._model(points.to(self._dtype, copy=True))
        boxes, logits = _checked(answer, self._where)
        return Proposals(boxes, logits, torch.arange(len(logits)))


class UserScores(ScoresOnlyDetector):
    """Model of points (N, 3) that returns numpy arrays: boxes (A, 7) and scores (A,); A may vary. Not differentiable.

    Args: model: gets points in float32. where: name of the file in error messages.
    """

    def __init__(self, model: Model, where: str) -> None:
        super().__init__(OWN, where, "Return probabilities: the sigmoid of logits")
        self._model = model

    def answer(self, points: Tensor) -> tuple[NDArray[Any], NDArray[Any]]:
        """See `ScoresOnlyDetector`. Raises InputError if the model fails or does not return two arrays."""
        with _clear_errors(self.where):
            found = self._model(points)
        if not _is_arrays(found):
            raise InputError("its answer is numpy arrays (boxes, scores) for some points only", self.where, _GUIDE)
        with _clear_errors(self.where):
            boxes, scores = (np.asarray(part, dtype=np.float64) for part in found)
        return boxes, scores


def load_user_detector(
    module: Path, weights: Path | None, precision: Precision = "float32"
) -> UserDetector | UserScores:
    """Load a detector from a Python file and test it on random points. ``load`` runs with a fixed torch seed.

    precision: "float64" converts the parameters of a torch module to float64; other values leave them unchanged. A
    function gets points in float32 at every precision, because its parameters cannot be converted.

    Raises InputError with the file and line if the file is missing, fails or has no ``load``, or if the model's output
    is not as `UserDetector` or `UserScores` requires, differs between two calls, or if tensors are not differentiable
    w.r.t. the points.
    """
    if not module.is_file():
        raise InputError("no such file", str(module), "Give detector.module=FILE.py")
    with torch.random.fork_rng(devices=[]), _clear_errors(str(module)):
        torch.manual_seed(0)
        load = getattr(_imported(module), "load", None)
        if not callable(load):
            raise InputError("it has no function load(weights)", str(module), _GUIDE)
        model = load(None if weights is None else str(weights))
    if not callable(model):
        raise InputError("load() returned nothing that can be called with points", str(module), _GUIDE)
    dtype = torch.float32
    if isinstance(model, nn.Module):
        model = model.eval().requires_grad_(False)
        if precision == "float64":
            model, dtype = model.double(), torch.float64
    with _clear_errors(str(module)):
        is_arrays = _is_arrays(model(probe_points().to(dtype)))
    if is_arrays:
        scores = UserScores(model, str(module))
        scores.try_on_random_points()
        return scores
    detector = UserDetector(model, str(module), dtype)
    _try(detector, str(module))
    return detector


def _is_arrays(answer: Any) -> bool:
    """True for a pair of numpy arrays."""
    return (
        isinstance(answer, tuple | list) and len(answer) == 2 and all(isinstance(part, np.ndarray) for part in answer)
    )


class _SourceLoader(importlib.machinery.SourceFileLoader):
    """Loader that always compiles the source: a .pyc file may belong to a content with another digest."""

    def path_stats(self, path: str | bytes) -> Any:
        raise OSError("compiled files are neither read nor written")


def _imported(path: Path) -> Any:
    """Import a file as a module whose name is a digest of its path and content."""
    key = str(path.resolve()).encode() + b"\0" + path.read_bytes()
    name = f"shift3d_own_{hashlib.blake2b(key, digest_size=16).hexdigest()}"
    if name not in sys.modules:
        loader = _SourceLoader(name, str(path))
        spec = importlib.util.spec_from_file_location(name, path, loader=loader)
        assert spec is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module  # dataclasses look the module up there during its import
        try:
            loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]


def _try(detector: UserDetector, where: str) -> None:
    points = probe_points().requires_grad_()
    first, second = detector.proposals(points), detector.proposals(points)
    if not first.logits.requires_grad:
        remedy = "Without a gradient, return numpy arrays: boxes (A, 7) and scores (A,) (docs/guides/detectors.md)"
        raise InputError("its logits do not depend on the points differentiably", where, remedy)
    if not torch.equal(first.logits, second.logits) or not torch.equal(first.boxes, second.boxes):
        raise InputError("two calls with the same points differ", where, "Draw nothing at random in the model")
    with _clear_errors(where):
        (gradient,) = torch.autograd.grad(first.logits.sum(), points, allow_unused=True)
    if gradient is None or not bool(torch.isfinite(gradient).all()):
        raise InputError("no finite gradient reaches the points", where, _GUIDE)
    try:
        empty = detector.proposals(points[:0].detach())
    except InputError as error:
        raise InputError(f"{error.what}, given no points", error.where, error.remedy) from error
    if len(empty.logits) != len(first.logits):
        raise InputError(f"{len(empty.logits)} boxes without points, {len(first.logits)} with", where, _GUIDE)
    # Real logits are not all >= 0, since without points no box holds a vehicle: these must be probabilities.
    if all(bool(((found.logits >= 0) & (found.logits <= 1)).all()) for found in (first, empty)):
        raise InputError("its logits all lie between 0 and 1", where, "Return them before the sigmoid")


def _checked(answer: Any, where: str) -> tuple[Tensor, Tensor]:
    """Return boxes (A, 7) float32 without gradient, and logits (A,)."""
    if not isinstance(answer, tuple | list) or len(answer) != 2 or not all(isinstance(part, Tensor) for part in answer):
        what = "its answer is neither torch tensors (boxes, logits) nor numpy arrays (boxes, scores)"
        raise InputError(what, where, _GUIDE)
    boxes, logits = answer
    if boxes.ndim != 2 or boxes.shape[1] != 7 or logits.shape != boxes.shape[:1] or not len(logits):
        what = f"boxes {tuple(boxes.shape)} and logits {tuple(logits.shape)}, not (A, 7) and (A,)"
        raise InputError(what, where, _GUIDE)
    boxes = boxes.detach().float()
    if not bool(torch.isfinite(boxes).all() & torch.isfinite(logits).all()) or not bool((boxes[:, 3:6] > 0).all()):
        raise InputError("boxes without a size, or NaN or infinity in its answer", where, "Repair the model")
    return boxes, logits


@contextlib.contextmanager
def _clear_errors(where: str) -> Iterator[None]:
    """Convert exceptions of the user's code to InputErrors that name the line of the file."""
    try:
        yield
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        places = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
        if isinstance(error, SyntaxError) and error.filename:
            places.append((error.filename, error.lineno))
        line = next((line for file, line in places[::-1] if Path(file).resolve() == Path(where).resolve()), None)
        what = f"{type(error).__name__}: {str(error)[:200]}"
        remedy = _ALONE if isinstance(error, ModuleNotFoundError) else "Repair the file"
        raise InputError(what, f"{where}, line {line}" if line else where, remedy) from error
