"""The harness of `make bench`: its file, its comparison of runs, its turns and its larger scenes."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from analytic_fields import ground_scan
from benchmarks.results import Results, comparison, read_results, summary
from benchmarks.timing import Timing, take_turns
from benchmarks.world import densified, with_beams_elsewhere

from shift3d.errors import InputError
from shift3d.scenes.scene import Scene

REPOSITORY = Path(__file__).resolve().parents[3]


def measured(**values: float) -> Results:
    results = Results()
    for name, value in values.items():
        results.add(name, value, "ratio", f"what {name} is of")
    return results


def cells(table: str, name: str) -> list[str]:
    return next(line for line in table.splitlines() if line.split()[:1] == [name]).split()[1:]


def street() -> Scene:
    points, _ = ground_scan(rings=16, columns=180)
    return Scene("flat", "test", points, np.zeros_like(points), ground_z_m=-1.73)


def test_the_file_holds_what_was_measured_and_nothing_else(tmp_path: Path) -> None:
    results = measured(render_cold_ratio=123.456789)
    results.time("step_ms", Timing((3.0, 1.0, 2.0)), "one step", "40 hits")
    results.write(tmp_path / "made" / "bench.json")
    assert json.loads((tmp_path / "made" / "bench.json").read_text()) == {
        "render_cold_ratio": {"value": 123.457, "unit": "ratio", "of": "what render_cold_ratio is of"},
        "step_ms": {"value": 2.0, "unit": "ms", "of": "one step", "low": 1.5, "high": 2.5, "note": "40 hits"},
    }


def test_a_ratio_of_medians_is_bounded_by_the_quartiles() -> None:
    results = Results()
    results.ratio("speed", Timing((100.0, 120.0, 140.0)), Timing((1.0, 2.0, 3.0)), "slow ms / fast ms")
    record = results.records["speed"]
    assert record["value"] == 60.0
    assert (record["low"], record["high"]) == (110.0 / 2.5, pytest.approx(130.0 / 1.5, rel=1e-5))


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_number_that_is_none_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="speed"):
        measured(speed=value)


def test_no_name_is_measured_twice() -> None:
    results = measured(speed=1.0)
    with pytest.raises(ValueError, match="speed was measured twice"):
        results.add("speed", 2.0, "ratio", "again")


def test_a_write_that_fails_leaves_the_earlier_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "bench.json"
    measured(speed=1.0).write(path)

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="disk is full"):
        measured(speed=2.0).write(path)
    assert read_results(path)["speed"]["value"] == 1.0
    assert [entry.name for entry in tmp_path.iterdir()] == ["bench.json"]


@pytest.mark.parametrize("text", ["", "[1]", '{"speed": {"value": 1.0, "unit": "ms"}}'])
def test_another_file_is_no_earlier_run(tmp_path: Path, text: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"other\.json"):
        read_results(path)


def test_comparison_shows_old_new_and_ratio() -> None:
    old, new = measured(same=2.0, gone=5.0, other=1.0), measured(same=3.0, fresh=7.0)
    new.add("other", 1.0, "ratio", "another scene")
    table = comparison(old.records, new.records)
    assert table.splitlines()[1].split() == ["name", "old", "new", "unit", "new", "/", "old"]
    assert cells(table, "same") == ["2", "3", "ratio", "1.5"]
    assert cells(table, "gone") == ["5", "-", "ratio", "-"]
    assert cells(table, "fresh") == ["-", "7", "ratio", "-"]
    assert cells(table, "other*") == ["1", "1", "ratio", "1"]
    assert table.splitlines()[-1].startswith("* not measured of the same thing")
    assert "*" not in comparison(old.records, old.records)


def test_a_missed_goal_is_said() -> None:
    table = summary(measured(render_cold_ratio=299.0, limit_ratio=2.9, attack_step_ratio=300.0).records)
    assert cells(table, "render_cold_ratio") == ["299", "ratio", ">=", "300", "MISSED"]
    assert cells(table, "limit_ratio") == ["2.9", "ratio", "<=", "3"]
    assert cells(table, "attack_step_ratio") == ["300", "ratio", ">=", "300"]


def test_calls_take_turns_in_alternating_order() -> None:
    order: list[str] = []
    calls = {"slow": (lambda: order.append("slow"), 1), "fast": (lambda: order.append("fast"), 2)}
    times = take_turns(calls, rounds=2)
    assert order == ["slow", "fast", "fast", "fast", "fast", "slow"]
    assert {name: len(timing.samples_ms) for name, timing in times.items()} == {"slow": 2, "fast": 4}


def test_beams_elsewhere_keep_clear_of_the_object() -> None:
    scene, theta = street(), torch.tensor([14.0, 6.0, -1.0, 0.3, 0.0, 0.0], dtype=torch.float64)
    grown = with_beams_elsewhere(scene, theta, 8, clear_m=9.0)
    grown.validate()
    assert len(grown.points) == 8 * len(scene.points)
    assert np.array_equal(grown.points[: len(scene.points)], scene.points)
    # No point of a new beam, from sensor to return, is near the object's centre.
    new = grown.points[len(scene.points) :].astype(np.float64)
    share = np.linspace(0.0, 1.0, 400)[:, None, None]
    apart = np.linalg.norm(share * new[::7] - theta[:3].numpy(), axis=2)
    assert apart.min() > 9.0 - 1e-3
    # The other points are all around it, at the scene's own ranges.
    assert np.linalg.norm(new, axis=1).max() == pytest.approx(np.linalg.norm(scene.points, axis=1).max(), rel=1e-5)
    azimuth = np.arctan2(new[:, 1], new[:, 0]) - math.atan2(6.0, 14.0)
    assert (np.abs(np.sin(azimuth)) < 0.5).any() and (np.cos(azimuth) < -0.9).any()


def test_a_densified_scene_has_so_many_points_on_the_same_surfaces() -> None:
    scene = street()
    dense = densified(scene, 5000)
    dense.validate()
    assert len(dense.points) == 5000
    assert np.array_equal(dense.points[: len(scene.points)], scene.points)
    ground = scene.points[:, 2].min()
    assert dense.points[:, 2].min() == ground  # turned about the vertical: heights are unchanged


def test_a_selected_part_runs_and_writes_its_records_alone(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pytest", "tests/benchmarks", "-o", "python_files=bench_*.py"]
    command += ["-o", "python_functions=bench_*", "-k", "gemm", "--quick", "--json", str(tmp_path / "bench.json")]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    records = read_results(tmp_path / "bench.json")
    assert {name.removesuffix("_bfloat16") for name in records} - {"gemm_peak_gflops"} == {
        "cores",
        "gemm_peak_gflops_float32",
        "gemm_peak_gflops_float64",
    }
    # Half the bytes, about twice the operations; and no present-day core does 10 TFLOP/s.
    assert 1.0 < records["gemm_peak_gflops_float64"]["value"] < records["gemm_peak_gflops_float32"]["value"] < 1e4
    assert all("quick run" in record["of"] for record in records.values())
    assert "gemm_peak_gflops_float32" in done.stdout
