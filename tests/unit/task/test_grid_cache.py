"""SDF grids in the cache folder: the bits of the first computation; torn, changed or foreign files are not used."""

from __future__ import annotations

import dataclasses
import os
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from short_tasks import make_spec

from shift3d.render.culling import Box
from shift3d.render.field.sdf_grid import SdfGrid
from shift3d.render.settings import STANDARD, RenderSettings
from shift3d.task.assets import Assets
from shift3d.task.grid_cache import cached_grid

LIVE = (torch.tensor([True, False, True]), torch.tensor([False, True]))


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "shift3d" / "grids"


def some_grid(live: tuple[torch.Tensor, ...] | None = LIVE, error_m: float = 0.1 + 0.2) -> SdfGrid:
    distance_m = torch.randn(3, 4, 5, generator=torch.Generator().manual_seed(0))
    distance_m[0, 0, 0] = torch.nan
    box = Box(torch.tensor([-2.1, -1.0, -0.7]).double(), torch.tensor([2.1, 1.0, 0.7]).double() / 3)
    return SdfGrid(box, distance_m, error_m, 90_001, live)


def equal(one: SdfGrid, two: SdfGrid) -> bool:
    lives = (one.live is None) == (two.live is None) and len(one.live or ()) == len(two.live or ())
    lives = lives and all(torch.equal(a, b) for a, b in zip(one.live or (), two.live or (), strict=True))
    numbers = (one.error_m, one.evaluations, one.distance_m.dtype) == (
        two.error_m,
        two.evaluations,
        two.distance_m.dtype,
    )
    same = torch.equal(one.distance_m.view(torch.int32), two.distance_m.view(torch.int32))
    return lives and numbers and same and one.box == two.box


def never(*_: object) -> SdfGrid:
    raise AssertionError("made again")


def kept(make: object, settings: RenderSettings = STANDARD, decoder: str = "d", vehicle: str = "v") -> SdfGrid:
    return cached_grid(decoder, vehicle, settings, make)  # type: ignore[arg-type]


@pytest.mark.parametrize("grid", [some_grid(), some_grid(None), some_grid((), float("inf"))])
def test_what_is_read_is_what_was_made_to_the_bit(grid: SdfGrid) -> None:
    assert kept(lambda: grid) is grid
    assert equal(kept(never), grid)


def test_another_decoder_vehicle_or_setting_has_a_grid_of_its_own() -> None:
    kept(some_grid)
    others = ({"decoder": "e"}, {"vehicle": "w"}, {"settings": replace(STANDARD, tolerance_m=2 * STANDARD.tolerance_m)})
    for other in others:
        with pytest.raises(AssertionError, match="made again"):
            kept(never, **other)


def test_other_threads_and_another_machine_may_round_differently(monkeypatch: pytest.MonkeyPatch) -> None:
    kept(some_grid)
    others = {"torch.get_num_threads": 7, "torch.backends.cpu.get_cpu_capability": "AVX9", "platform.node": "another"}
    for place, found in others.items():
        with monkeypatch.context() as patch, pytest.raises(AssertionError, match="made again"):
            patch.setattr(place, lambda found=found: found)
            kept(never)


@pytest.mark.parametrize("place", ["torn", "a bit of the distances", "a bit of the facts", "empty"])
def test_a_damaged_file_is_made_again(cache: Path, place: str) -> None:
    grid = some_grid()
    kept(lambda: grid)
    (file,) = cache.iterdir()
    whole = bytearray(file.read_bytes())
    at = {"a bit of the distances": len(whole) - 70, "a bit of the facts": whole.index(b"evaluations")}
    damaged = bytearray(whole)
    if place in at:
        damaged[at[place]] ^= 1
    file.write_bytes({"torn": bytes(whole[: len(whole) // 2]), "empty": b""}.get(place, bytes(damaged)))
    assert kept(lambda: grid) is grid
    assert equal(kept(never), grid), "the good one is kept"


def test_a_folder_that_cannot_be_written_is_done_without(cache: Path) -> None:
    cache.parent.mkdir(parents=True)
    cache.write_text("a file stands where the folder would")
    grid = some_grid()
    assert kept(lambda: grid) is grid and kept(lambda: grid) is grid


def test_the_oldest_make_room(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shift3d.task.grid_cache.FILES_KEPT", 2)
    for age, vehicle in enumerate("abc"):
        kept(some_grid, vehicle=vehicle)
        for file in cache.iterdir():
            os.utime(file, (file.stat().st_mtime - 100 * (3 - age),) * 2)
    assert len(list(cache.iterdir())) == 2
    kept(never, vehicle="b"), kept(never, vehicle="c")
    with pytest.raises(AssertionError, match="made again"):
        kept(never, vehicle="a")


def test_what_cannot_be_deleted_stays_and_stops_nothing(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shift3d.task.grid_cache.FILES_KEPT", 1)
    old = cache / "old"  # a folder stands for the file of another user, which unlink refuses too
    old.mkdir(parents=True)
    os.utime(old, (0, 0))
    grid = some_grid()
    assert kept(lambda: grid) is grid and equal(kept(never), grid) and old.is_dir()


def test_another_worker_reads_the_grid_of_a_shipped_vehicle(assets: Assets, monkeypatch: pytest.MonkeyPatch) -> None:
    one, two = (dataclasses.replace(assets, _sdf_grids=OrderedDict()) for _ in range(2))
    made = one.sdf_grid_of(make_spec(), STANDARD)
    monkeypatch.setattr(SdfGrid, "of", never)
    read = two.sdf_grid_of(make_spec(), STANDARD)
    assert made is not None and read is not None and equal(made, read) and made.live is not None
