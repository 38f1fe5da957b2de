"""Answers of a detector on disk, a small file a scene, so that an interrupted evaluation goes on where it stopped."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from shift3d.errors import InputError
from shift3d.evaluation.frames import DetectedFrame, Found, Truth
from shift3d.store.atomic import write_atomic
from shift3d.training.detector.detect_scenes import Answer


def answers_of(names: Iterable[str], folder: Path, detect: Callable[[list[str]], Iterator[Answer]]) -> Iterator[Answer]:
    """The answer of every scene, in order: from ``folder`` where it lies there, else detected and written there.

    detect: names of the scenes that are missing to their answers, in that order.

    Raises InputError: a file in ``folder`` is torn, or whatever ``detect`` raises.
    """
    names = list(names)
    coming = detect([name for name in names if not _file(folder, name).exists()])
    for name in names:
        if _file(folder, name).exists():
            yield read_answer(_file(folder, name))
        else:
            answer = next(coming)
            write_answer(_file(folder, name), answer)
            yield answer


def _file(folder: Path, name: str) -> Path:
    return folder / f"{name.replace('/', '_')}.npz"


def write_answer(file: Path, answer: Answer) -> None:
    """Write one answer atomically. Raises InputError on a full disk."""
    truth, found = answer.frame.truth, answer.frame.found
    content = io.BytesIO()
    np.savez(
        content,
        scene=np.array(answer.frame.scene),
        milliseconds=np.array([answer.scene_ms, answer.detect_ms]),
        truth_boxes=truth.boxes,
        num_points=truth.num_points,
        counts=truth.counts,
        difficulty=truth.difficulty,
        names=np.array(truth.names, dtype=np.str_),
        kinds=np.array(truth.kinds, dtype=np.str_),
        boxes=found.boxes,
        scores=found.scores,
        labelled=found.labelled,
        image_height_px=found.image_height_px,
    )
    write_atomic(file, content.getvalue())


def read_answer(file: Path) -> Answer:
    """Read what :func:`write_answer` wrote, bit for bit. Raises InputError for a file that it did not write."""
    try:
        with np.load(file, allow_pickle=False) as data:
            truth = Truth(
                data["truth_boxes"],
                data["num_points"],
                data["counts"],
                data["difficulty"],
                tuple(str(name) for name in data["names"]),
                tuple(str(kind) for kind in data["kinds"]),
            )
            found = Found(data["boxes"], data["scores"], data["labelled"], data["image_height_px"])
            scene_ms, detect_ms = (float(value) for value in data["milliseconds"])
            return Answer(DetectedFrame(str(data["scene"]), truth, found), scene_ms, detect_ms)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"is no stored answer ({type(error).__name__})", str(file), "Remove the file") from error
