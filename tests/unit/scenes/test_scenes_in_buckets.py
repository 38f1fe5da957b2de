"""Scenes of a bucket equal those of the folder that was copied into it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from bucket_server import ENVIRONMENT, bucket_server, new_bucket
from waymo_segment import SEGMENT, START, write_segment

from shift3d.errors import InputError
from shift3d.scenes.waymo.scenes import WaymoScenes
from shift3d.store.location import Location
from shift3d.store.resolve import as_location


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    with bucket_server() as address:
        yield address


@pytest.fixture
def bucket(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> Location:
    for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": endpoint}.items():
        monkeypatch.setenv(name, value)
    return as_location(f"s3://{new_bucket(endpoint)}/data")


def copy(folder: Path, bucket: Location) -> None:
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            target = bucket
            for part in path.relative_to(folder).parts:
                target = target / part
            target.write_atomic(path.read_bytes())


def test_a_waymo_segment(tmp_path: Path, bucket: Location) -> None:
    write_segment(tmp_path, frames=2)
    copy(tmp_path, bucket)
    here, there = WaymoScenes(tmp_path), WaymoScenes(bucket)
    assert there.names() == here.names()
    name = f"{SEGMENT}-{START}"
    assert there.load(name).content_hash() == here.load(name).content_hash()
    before = there.source(name)
    assert WaymoScenes(str(bucket)).source(name) == before
    part = bucket / "lidar_pose" / f"{SEGMENT}.parquet"
    part.write_atomic(part.read_bytes()[:-9])
    assert WaymoScenes(bucket).source(name) != before
    with pytest.raises(InputError, match=r"s3://.*lidar_pose.*not a readable Parquet"):
        there.load(name)
    part.delete()
    with pytest.raises(InputError, match=r"s3://.*lidar_pose.*missing"):
        there.load(name)
