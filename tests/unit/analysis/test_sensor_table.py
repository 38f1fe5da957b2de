"""The paired table of sensors: objects are paired by street, and differences are those of the pairs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from types import SimpleNamespace

import pandas as pd
import pytest

from shift3d.analysis.results import Sweep, places_of
from shift3d.analysis.statistics.intervals import vehicle_mean_interval
from shift3d.analysis.tables.sensors import paired_scores, sensor_table
from shift3d.analysis.tables.table import Cell

LOSS = {"waymo_top": 0.0, "hdl32": 0.25, "hdl64": 0.0}


def scores(beams: tuple[str, ...] = ("waymo_top", "hdl32"), streets: int = 6) -> pd.DataFrame:
    """Return an object per street with score 0.5 + 0.05 s, 0.25 less under the other beams; one street has none."""
    rows = [
        {"dataset": f"street-waymo_top-beams_{name}", "scene": f"street-test-waymo_top-{street:06d}-beams_{name}"}
        | {"vehicle": "suv", "mode": mode, "lambda": weight, "alpha": 0.01, "detector": "p", "scored_by": "p"}
        | {"accuracy": "standard", "search": "descent", "method": method, "replicate": 0, "object_points": 400}
        | {"task_id": f"{name}-{street}-{mode}", "effects": [], "x_m": 20.0, "y_m": 1.0, "yaw_rad": 0.1}
        | {"score": None if name == "hdl32" and street == 5 else 0.5 + 0.05 * street - LOSS[name]}
        for name in beams
        for street in range(streets)
        for method in ("baseline", "random", "adversarial")
        for mode, weight in (("shape", 1.0), ("pose", float("nan")))
    ]
    return pd.DataFrame(rows)


def test_objects_are_paired_by_street() -> None:
    found = paired_scores(scores())
    assert {(mode, method) for mode, method, *_ in found} == {
        (mode, method) for mode in ("shape", "pose") for method in ("baseline", "adversarial")
    }
    for score, points in found.values():
        both = score.dropna()
        assert list(score.columns) == ["waymo_top", "hdl32"] and len(both) == 5 and len(score) == 6
        assert (both["waymo_top"] - both["hdl32"]).tolist() == pytest.approx([0.25] * 5)
        assert (points.dropna() == 400).to_numpy().all()


def test_the_table_says_the_difference_of_the_pairs_alone() -> None:
    table = sensor_table(scores())
    assert table is not None
    (own, other) = [line for line in table.lines if str(line[0]).startswith("baseline, shape")]
    assert own[2:6] == ["waymo_top", "6", "400", "0.625"] and own[6] == "-"
    # Six objects under the first sensor, five of them under the other: 0.6 - 0.25.
    assert other[2:6] == ["hdl32", "5", "400", "0.350"]
    assert str(other[6]).startswith("-0.250 [-0.250, -0.250]")


def test_misses_are_counted_where_both_miss() -> None:
    rows = scores()
    rows["score"] = rows["score"] - 0.53  # first sensor: three streets below 0.1; other sensor: all
    table = sensor_table(rows)
    assert table is not None
    (own, other) = [line for line in table.lines if str(line[0]).startswith("baseline, shape")]
    assert own[7] == "50%" and other[7] == "100%" and other[8] == "3 of 3"


def test_replicates_of_a_task_are_objects_of_their_own() -> None:
    rows = scores(streets=5)
    low = rows.assign(score=0.02, x_m=30.0, task_id="again-" + rows["task_id"])  # at another place
    table = sensor_table(pd.concat([rows, low]))
    assert table is not None
    (own, _) = [line for line in table.lines if str(line[0]).startswith("baseline, shape")]
    assert own[3] == "10" and own[7] == "50%", "a mean over replicates would miss none"


def test_lambdas_share_a_baseline_and_a_task_that_is_missing_moves_no_partner() -> None:
    one = scores()
    ten = one.assign(**{"lambda": one["lambda"] * 10.0, "task_id": "ten-" + one["task_id"]})
    found = paired_scores(pd.concat([one, ten]))
    assert len(found["shape", "baseline", "p", "p", "descent", ""][0]) == 6
    assert len(found["shape", "adversarial", "p", "p", "descent", ""][0]) == 12
    fog = one.assign(effects=one["effects"].map(lambda _: ["fog"]), score=0.9, task_id="fog-" + one["task_id"])
    lost = pd.concat([one[~one["task_id"].str.startswith("hdl32-0-")], fog])
    for (*_, settings), (score, _) in paired_scores(lost).items():
        fell = set((score["waymo_top"] - score["hdl32"]).dropna().round(9))
        assert fell == {"no effects": {0.25}, "fog": {0.0}}[settings]


def test_effects_have_lines_of_their_own() -> None:
    dry = scores()
    fog = dry.assign(
        effects=dry["effects"].map(lambda _: ["fog"]), score=dry["score"] - 0.1, task_id="f" + dry["task_id"]
    )
    table = sensor_table(pd.concat([dry, fog]))
    assert table is not None
    found = {(line[0], line[2]): line[5] for line in table.lines if str(line[0]).startswith("baseline, pose")}
    assert found == {
        ("baseline, pose, descent, p, no effects", "waymo_top"): "0.625",
        ("baseline, pose, descent, p, no effects", "hdl32"): "0.350",
        ("baseline, pose, descent, p, fog", "waymo_top"): "0.525",
        ("baseline, pose, descent, p, fog", "hdl32"): "0.250",
    }


def test_a_street_in_rain_and_in_fog_is_one_draw() -> None:
    """One street gives two results, which count as one."""
    dry = scores(streets=12)
    odd = dry["scene"].str.extract(r"-(\d{6})-", expand=False).astype(int) % 2
    dry = dry.assign(score=dry["score"] - 0.1 * odd * dry["scene"].str.endswith("hdl32"))
    fog = dry.assign(task_id="fog-" + dry["task_id"])
    fog[["dataset", "scene"]] = fog[["dataset", "scene"]].replace("-beams", "-fog50-beams", regex=True)
    once, twice = (sensor_table(rows) for rows in (dry, pd.concat([dry, fog])))
    assert once is not None and twice is not None
    assert [line[3] for line in twice.lines] == [str(2 * int(str(line[3]))) for line in once.lines]

    def widths(lines: Sequence[Sequence[Cell]]) -> list[float]:
        ends = [re.findall(r"[-+][0-9.]+", str(line[6])) for line in lines if line[6] != "-"]
        return [float(high) - float(low) for _, low, high in ends]

    assert widths(twice.lines) == pytest.approx(widths(once.lines), rel=0.15)


def test_one_sensor_makes_no_table() -> None:
    assert sensor_table(scores(("waymo_top",))) is None
    plain = scores(("waymo_top",)).replace(r"-beams_waymo_top", "", regex=True)
    assert sensor_table(plain) is None


def test_a_street_is_one_place_under_any_beams() -> None:
    """Intervals redraw streets: three sensors do not add streets, and so no certainty."""
    rows = scores(("waymo_top", "hdl32", "hdl64"), streets=12)
    assert places_of(rows).nunique() == 12
    alike = rows.assign(score=0.05 * places_of(rows).str[-6:].astype(int), natural=None, best_step=1)
    tasks = SimpleNamespace(effects_requested_of=lambda ids: [["auto"]] * len(ids))
    empty = [pd.DataFrame()] * 13
    scored = Sweep(SimpleNamespace(tasks=tasks), {}, alike, *empty).scored  # type: ignore[arg-type]
    baselines = scored[(scored["method"] == "baseline") & (scored["mode"] == "shape")]
    three = vehicle_mean_interval(baselines)
    one = vehicle_mean_interval(baselines[baselines["scene"].str.endswith("hdl32")])
    assert three.mean == pytest.approx(one.mean)
    assert three.high - three.low == pytest.approx(one.high - one.low, rel=0.1)
