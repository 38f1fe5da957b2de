"""A suite is its frozen files, byte for byte, or an error that names the file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from suites_by_hand import POINTS, write_suite

from shift3d.errors import InputError
from shift3d.suite.frozen import box_of, manifest_bytes, read_suite


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_suite(tmp_path / "suite")
    return tmp_path / "suite"


def test_an_objects_scene_is_its_background_with_the_changed_points(folder: Path) -> None:
    suite = read_suite(folder)
    row = suite.objects.iloc[1].to_dict()
    background = suite.background(row["background"])
    points, new = suite.points_of(row, background), np.reshape(row["points"], (-1, 3))
    changed = np.zeros(len(points), bool)
    changed[row["hits"]] = True
    assert len(points) == POINTS + 1
    assert np.array_equal(points[changed], new) and np.array_equal(points[~changed], background[~changed[:-1]])
    assert np.array_equal(box_of({**row, "ground_z_m": -1.7}), [10.0, 10.0, 0.8 + 1.7, 4.5, 1.9, 1.6, 0.0])


def test_every_changed_byte_is_found_and_its_file_named(folder: Path) -> None:
    for file in [path for path in sorted(folder.rglob("*")) if path.is_file()]:
        content = file.read_bytes()
        for changed in (content[:-9] + bytes([content[-9] ^ 1]) + content[-8:], content[:-2], b""):
            file.write_bytes(changed)
            with pytest.raises(InputError, match=file.name):
                read_suite(folder)
        file.unlink()
        with pytest.raises(InputError, match=file.name):
            read_suite(folder)
        file.write_bytes(content)
    read_suite(folder)


def test_a_file_put_in_place_of_another_with_its_digest_changes_the_suites(folder: Path) -> None:
    manifest = json.loads((folder / "suite.json").read_bytes())
    manifest["hard_objects"] += 1
    (folder / "suite.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match=r"suite\.json: was changed"):
        read_suite(folder)
    (folder / "suite.json").write_bytes(manifest_bytes(manifest))
    assert read_suite(folder).digest != manifest["digest"]


def test_what_is_no_suite_of_this_version_is_said(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such suite"):
        read_suite(tmp_path)
    manifest = json.loads((folder / "suite.json").read_bytes())
    for version in (0, 2, None, "1"):
        (folder / "suite.json").write_bytes(manifest_bytes({**manifest, "version": version}))
        with pytest.raises(InputError, match=f"version {version}; this program reads version 1"):
            read_suite(folder)
    for text in ("[]", "no json", ""):
        (folder / "suite.json").write_text(text)
        with pytest.raises(InputError, match=r"suite\.json"):
            read_suite(folder)
    write_suite(tmp_path / "empty", scenes=0)
    with pytest.raises(InputError, match="contains no object"):
        read_suite(tmp_path / "empty")
