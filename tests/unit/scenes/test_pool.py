"""The pool of vehicle meshes: the cache on disk changes only the time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from shift3d.scenes.street.build import pool
from shift3d.store import user_cache


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    pool.pool_vehicle.cache_clear()
    yield pool.cache_folder()
    pool.pool_vehicle.cache_clear()


def hits(vehicle: pool.PoolVehicle) -> np.ndarray:
    origins = np.tile(np.array([[10.0, 0.0, 0.0]], np.float32), (50, 1))
    z = np.linspace(-0.5, 0.5, 50)
    directions = np.stack((np.full(50, -10.0), np.zeros(50), z), axis=1)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return vehicle.intersector.first_hit(origins, directions.astype(np.float32))[0]


def test_built_stored_damaged_and_unwritable_give_the_same_vehicle(empty_cache: Path) -> None:
    built = hits(pool.pool_vehicle("test", 4))
    (stored,) = empty_cache.glob("*")
    assert stored.name == "test-004.npz"
    pool.pool_vehicle.cache_clear()
    np.testing.assert_array_equal(hits(pool.pool_vehicle("test", 4)), built)
    flags = bytearray(stored.read_bytes())
    flags[flags.index(b"PK\x01\x02") + 8] |= 0x20  # the directory says that an array is a patch of another file
    for damaged in (stored.read_bytes()[:1000], b"", bytes(flags)):
        stored.write_bytes(damaged)
        pool.pool_vehicle.cache_clear()
        np.testing.assert_array_equal(hits(pool.pool_vehicle("test", 4)), built)
    assert [path.name for path in empty_cache.glob("*")] == ["test-004.npz"]


@pytest.fixture
def digests() -> Iterator[Callable[[], None]]:
    def forget() -> None:
        user_cache.source_digest.cache_clear()
        user_cache.program_digest.cache_clear()

    yield forget
    forget()


@pytest.mark.parametrize("part", ["vehicles/family/solid.py", "seeding.py", "scenes/street/build/pool.py"])
def test_another_program_keeps_meshes_elsewhere(
    digests: Callable[[], None], monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    known, read = pool.cache_folder(), Path.read_bytes
    digests()
    assert pool.cache_folder() == known
    with monkeypatch.context() as patch:
        ending = f"/shift3d/{part}"
        patch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * path.as_posix().endswith(ending))
        digests()
        assert pool.cache_folder() != known


@pytest.mark.parametrize("other", ["numpy", "torch"])
def test_another_library_keeps_meshes_elsewhere(
    other: str, digests: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    known, version = pool.cache_folder(), user_cache.importlib.metadata.version
    digests()
    with monkeypatch.context() as patch:
        patch.setattr(
            user_cache.importlib.metadata, "version", lambda library: version(library) + "x" * (library == other)
        )
        assert pool.cache_folder() != known


def test_a_cache_that_cannot_be_written_is_done_without(empty_cache: Path) -> None:
    empty_cache.parent.parent.mkdir(parents=True, exist_ok=True)
    empty_cache.parent.write_text("a file where the folder should be")
    assert pool.pool_vehicle("test", 1).radius_m > 2.0
    assert empty_cache.parent.read_text() == "a file where the folder should be"


def test_a_vehicle_is_centred_and_of_a_cars_size() -> None:
    for number in range(9):
        vehicle = pool.pool_vehicle("val", number)
        assert np.all((vehicle.size_m > (3.2, 1.5, 1.0)) & (vehicle.size_m < (6.1, 2.2, 2.2)))
        assert np.linalg.norm(vehicle.size_m) / 2 >= vehicle.radius_m - 0.011
