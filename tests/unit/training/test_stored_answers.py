"""Answers on disk: the same bits back, only missing ones detected again, foreign files refused."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from small_scenes import PointDetector, SmallScenes

from shift3d.errors import InputError
from shift3d.training.detector.detect_scenes import (
    SceneDetections,
    detect_frame,
    read_scene_detections,
    stored_or_detected,
    write_scene_detections,
)

NAMES = [f"small-{index}" for index in range(4)]


def _detect(names: list[str]) -> Iterator[SceneDetections]:
    for name in names:
        yield detect_frame(PointDetector(), SmallScenes(), name)


def _arrays(answer: SceneDetections) -> list[bytes]:
    parts = (*vars(answer.frame.truth).values(), *vars(answer.frame.found).values())
    return [part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode() for part in parts]


def test_written_and_read_again_it_is_the_same_to_the_bit(tmp_path: Path) -> None:
    (answer,) = _detect(["small-1"])
    write_scene_detections(tmp_path / "a.npz", answer)
    again = read_scene_detections(tmp_path / "a.npz")
    assert _arrays(again) == _arrays(answer) and again.frame.scene == "small-1"
    assert (again.scene_ms, again.detect_ms) == (answer.scene_ms, answer.detect_ms)


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    whole = [_arrays(answer) for answer in _detect(NAMES)]
    begun = stored_or_detected(NAMES, tmp_path, _detect)
    next(begun)
    next(begun)
    begun.close()
    (tmp_path / "small-0.npz").unlink()  # a gap among existing files
    requested: list[str] = []

    def detect(names: list[str]) -> Iterator[SceneDetections]:
        requested.extend(names)
        return _detect(names)

    assert [_arrays(answer) for answer in stored_or_detected(NAMES, tmp_path, detect)] == whole
    assert requested == ["small-0", "small-2", "small-3"]
    assert [_arrays(answer) for answer in stored_or_detected(NAMES, tmp_path, detect)] == whole
    assert len(requested) == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{name}.npz" for name in NAMES]


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 torn"])
def test_a_file_that_is_no_answer_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "small-0.npz").write_bytes(content)
    with pytest.raises(InputError, match=r"small-0\.npz"):
        list(stored_or_detected(NAMES, tmp_path, _detect))


@pytest.mark.parametrize(("place", "bit"), [(10, 0x20), (8, 0x01)], ids=["another packing", "encrypted"])
def test_a_flipped_bit_in_a_header_is_named_too(place: int, bit: int, tmp_path: Path) -> None:
    file = tmp_path / "small-0.npz"
    write_scene_detections(file, next(_detect(NAMES)))
    content = bytearray(file.read_bytes())
    content[content.rindex(b"PK\x01\x02") + place] ^= bit
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"small-0\.npz"):
        list(stored_or_detected(NAMES, tmp_path, _detect))


def test_what_was_detected_in_other_files_is_detected_again(tmp_path: Path) -> None:
    states = dict.fromkeys(NAMES, "first")
    requested: list[str] = []

    def detect(names: list[str]) -> Iterator[SceneDetections]:
        requested.extend(names)
        return _detect(names)

    def run() -> list[str]:
        requested.clear()
        list(stored_or_detected(NAMES, tmp_path, detect, states.__getitem__))
        return list(requested)

    for answer in _detect(["small-3"]):  # of a program that did not state the files
        write_scene_detections(tmp_path / "small-3.npz", answer)
    assert run() == NAMES and run() == []
    states["small-1"] = "changed"
    assert run() == ["small-1"] and run() == []
