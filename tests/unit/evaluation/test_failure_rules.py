"""Failure rules: found if one exists, none otherwise, and tested on objects on which they were not found."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import valid_sweeps

from shift3d.analysis.results import Sweep, read_sweep
from shift3d.analysis.statistics.intervals import difference_interval
from shift3d.analysis.tables.failure_rules import failure_rules, left_out, rule_objects, rule_text, rules_table
from shift3d.errors import InputError
from shift3d.evaluation.failure_rules import Condition, FailureRule, aspect_deg, find_rules
from shift3d.store.log_entries import read_log
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.results.final import write_final

SIZES = ("length_m", "width_m", "height_m", "clearance_m")


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Sweep:
    folder = tmp_path_factory.mktemp("sweep")
    valid_sweeps.write_sweep(folder)
    write_final(folder, read_plan(folder), read_log(folder))
    return read_sweep(folder)


def drawn(count: int = 400) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {"range_m": rng.uniform(15, 50, count), "height_m": rng.uniform(1.2, 2.0, count)}


def test_a_rule_that_made_the_scores_is_found() -> None:
    quantities = drawn()
    low = (quantities["range_m"] > 35) & (quantities["height_m"] <= 1.4)
    rules = find_rules(quantities, np.where(low, 0.2, 0.8))
    assert len(rules) == 1
    assert (rules[0].holds(quantities) == low).all()
    bounds = {one.quantity: one for one in rules[0].conditions}
    assert bounds["range_m"].low == pytest.approx(35, abs=0.5) and math.isinf(bounds["range_m"].high)
    assert bounds["height_m"].high == pytest.approx(1.4, abs=0.02) and math.isinf(bounds["height_m"].low)


def test_a_range_between_two_bounds_is_one_condition() -> None:
    quantities = drawn()
    low = (quantities["range_m"] > 25) & (quantities["range_m"] <= 35)
    (rule,) = find_rules(quantities, np.where(low, 0.3, 0.8))
    assert len(rule.conditions) == 1 and rule_text(rule) == "range 25 m to 35 m"


def test_a_large_effect_does_not_hide_a_smaller_one() -> None:
    """Far objects would score higher than all others, half of which score 0.1."""
    quantities = drawn()
    low, far = quantities["height_m"] <= 1.6, quantities["range_m"] > 40
    first, second = find_rules(quantities, np.where(low, 0.1, np.where(far, 0.6, 0.8)))
    assert (first.holds(quantities) == low).all()
    assert (second.holds(quantities)[~low] == far[~low]).all()


def test_no_rule_where_nothing_tells_objects_apart() -> None:
    assert find_rules(drawn(), np.full(400, 0.7)) == []
    assert find_rules({}, np.linspace(0, 1, 400)) == []
    few = {name: values[:10] for name, values in drawn().items()}
    assert find_rules(few, np.linspace(0, 1, 10)) == []


def test_the_angle_to_the_line_of_sight_is_that_of_the_axis() -> None:
    at = np.array([10.0, 0.0, 10.0, -10.0])
    left = np.array([0.0, 10.0, 10.0, 0.0])
    yaw = np.array([0.0, 0.0, math.pi / 4, math.pi / 3])
    assert aspect_deg(at, left, yaw) == pytest.approx([0.0, 90.0, 0.0, 60.0], abs=1e-6)
    assert aspect_deg(at, left, yaw + math.pi) == pytest.approx(aspect_deg(at, left, yaw), abs=1e-6)


def test_the_difference_of_means_and_its_interval() -> None:
    places = [f"s{number // 4}" for number in range(80)]
    inside = np.arange(80) % 2 == 0
    exact = difference_interval(np.where(inside, 0.2, 0.7), inside, places)
    assert (exact.mean, exact.low, exact.high) == pytest.approx((-0.5, -0.5, -0.5))
    rng = np.random.default_rng(1)
    noisy = difference_interval(np.where(inside, 0.2, 0.7) + rng.normal(0, 0.1, 80), inside, places)
    assert noisy.low < -0.5 < noisy.high and noisy.high - noisy.low < 0.15
    assert math.isinf(difference_interval([0.1, 0.2], np.array([True, False]), ["a", "b"]).high)


def objects(transfers: bool = True, scenes: int = 20, vehicles: int = 4) -> pd.DataFrame:
    """Return objects of which the detector misses far and low ones; transfers: on the second half of vehicles, too."""
    rng = np.random.default_rng(2)
    rows = []
    for scene in range(scenes):
        for vehicle in range(vehicles):
            far, low = rng.uniform(15, 50), rng.uniform(1.2, 2.0)
            missed = far > 35 and (transfers or vehicle % 2 == 0)
            for detector in ("pointpillars", "sst"):
                score = (0.2 if missed else 0.8) + rng.normal(0, 0.02)
                rows.append({"place": f"s{scene:02}", "vehicle": f"v{vehicle}", "detector": "pointpillars",
                             "scored_by": detector, "score": score, "range_m": far, "height_m": low})  # fmt: skip
    return pd.DataFrame(rows).assign(aspect_deg=0.0, tilt_deg=0.0, length_m=4.5, width_m=1.8, clearance_m=np.nan)


def test_a_rule_holds_where_it_holds_on_everything_that_it_was_not_found_on() -> None:
    (found,) = failure_rules(objects())
    assert found.confirmed
    assert set(found.tried) == {"other scenes", "other vehicles", "scored by sst"}
    assert all(interval.mean == pytest.approx(-0.6, abs=0.05) for interval in found.tried.values())
    assert [condition.quantity for condition in found.rule.conditions] == ["range_m"]
    assert str(rules_table([found])).splitlines()[-1].endswith("yes")


def test_a_rule_is_tried_on_the_objects_that_no_rule_before_it_holds_for() -> None:
    rows = objects(scenes=80)
    low, far = rows["height_m"] <= 1.6, rows["range_m"] > 35
    first, second = failure_rules(rows.assign(score=np.where(low, 0.1, np.where(far, 0.6, 0.8))))
    assert [found.rule.conditions[0].quantity for found in (first, second)] == ["height_m", "range_m"]
    assert first.confirmed and second.confirmed
    assert all(interval.mean == pytest.approx(-0.2) for interval in second.tried.values())
    assert [line.startswith("else range") for line in str(rules_table([first, second])).splitlines()[-2:]] == [
        False,
        True,
    ]


def test_a_rule_of_some_vehicles_alone_does_not_hold() -> None:
    (found,) = failure_rules(objects(transfers=False))
    assert found.tried["other scenes"].high < 0
    assert not found.confirmed and found.tried["other vehicles"].high > 0
    assert str(rules_table([found])).splitlines()[-1].endswith("no")


def test_another_detector_is_asked_about_objects_that_the_rule_was_not_found_on() -> None:
    """The other detector's scores of the objects on which the rule was found do not count."""
    rows = objects()
    found_on = rows["place"].isin(sorted(rows["place"].unique())[::2]) & rows["vehicle"].isin(["v0", "v2"])
    (as_drawn,) = failure_rules(rows)
    (changed,) = failure_rules(rows.assign(score=rows["score"].mask(found_on & (rows["scored_by"] == "sst"), 0.99)))
    assert changed.tried == as_drawn.tried


def test_an_object_whose_size_is_not_known_takes_no_size_from_the_others() -> None:
    rows = objects().assign(range_m=20.0)
    rows["score"] = np.where(rows["height_m"] > 1.7, 0.2, 0.8)
    (whole,) = failure_rules(rows)
    assert [condition.quantity for condition in whole.rule.conditions] == ["height_m"]
    assert left_out(rows) is None, "clearance, which no object has, is required of none"
    lacking = rows.assign(height_m=rows["height_m"].mask(rows.index < 2))
    (found,) = failure_rules(lacking)
    assert [condition.quantity for condition in found.rule.conditions] == ["height_m"]
    assert left_out(lacking) == f"2 of {len(rows)} scored objects are left out: their sizes are unknown"
    (without,) = failure_rules(rows[rows.index >= 2])
    assert found == without
    unmeasured = rows.assign(height_m=rows["height_m"].mask(rows.index % 3 > 0), range_m=objects()["range_m"])
    assert left_out(unmeasured) is None, "what most objects lack is required of none"


def by_chance(seed: int, scenes: int = 20, vehicles: int = 60) -> pd.DataFrame:
    """Return vehicles that are missed more or less for their own reasons: neither size nor any other column matters."""
    rng = np.random.default_rng(seed)
    own = rng.normal(0.6, 0.2, vehicles)
    sizes = pd.DataFrame(rng.uniform(1.0, 2.0, (vehicles, 4)), columns=list(SIZES))
    rows = pd.DataFrame(
        {"place": f"s{scene:02}", "vehicle": f"v{vehicle:02}", "detector": "a", "scored_by": by}
        for scene in range(scenes) for vehicle in range(vehicles) for by in "ab"
    )  # fmt: skip
    number = rows["vehicle"].str[1:].astype(int)
    score = own[number] + rng.normal(0, 0.1, len(rows))
    rows = rows.assign(score=score, range_m=20.0, aspect_deg=0.0, tilt_deg=0.0)
    return rows.join(sizes.loc[number].reset_index(drop=True))


def test_what_vehicles_owe_to_chance_confirms_no_rule_about_other_vehicles() -> None:
    """More scenes add no vehicles. Resampling of scenes alone would confirm a third of the rules."""
    found = [rule for seed in range(12) for rule in failure_rules(by_chance(seed))]
    assert len(found) >= 30
    of_same = [rule.tried["other scenes"].high < 0 for rule in found]
    assert sum(of_same) / len(found) >= 0.95, "of the same vehicles the rules are true"
    assert sum(rule.confirmed for rule in found) / len(found) <= 0.1


def test_vehicles_are_draws_as_scenes_are() -> None:
    """Scores depend on vehicles alone: in any number of scenes, the difference has the uncertainty of the vehicles."""
    rng = np.random.default_rng(3)
    own = np.concatenate((rng.normal(0.3, 0.1, 40), rng.normal(0.7, 0.1, 40)))
    vehicles, places = np.repeat(np.arange(80), 12), np.tile(np.arange(12), 80)
    inside = vehicles < 40
    alone = difference_interval(own[vehicles], inside, list(places))
    assert (alone.low, alone.high) == pytest.approx((alone.mean, alone.mean)), "scenes alone see nothing of it"
    both = difference_interval(own[vehicles], inside, list(places), list(vehicles))
    half = 1.96 * math.hypot(own[:40].std() / 40**0.5, own[40:].std() / 40**0.5)
    assert both.mean == alone.mean == pytest.approx(own[:40].mean() - own[40:].mean())
    assert (both.low, both.high) == pytest.approx((both.mean - half, both.mean + half), abs=0.1 * half)
    one = difference_interval(own[vehicles], vehicles == 0, list(places), list(vehicles))
    assert math.isinf(one.high), "one vehicle says nothing of others"


def test_a_rule_that_no_other_vehicle_can_be_asked_about_does_not_hold() -> None:
    rows = objects().assign(range_m=20.0, height_m=1.5)
    tall = rows["vehicle"] == "v0"  # of the half that rules are found on
    (found,) = failure_rules(rows.assign(height_m=rows["height_m"].mask(tall, 2.0), score=np.where(tall, 0.2, 0.8)))
    assert found.tried["other scenes"].high < 0 and found.tried["other vehicles"] is None
    assert not found.confirmed
    table = rules_table([found])
    assert dict(zip(table.header, table.lines[0]))["other vehicles"] == "-"
    assert str(table).splitlines()[-1].endswith("no")
    tall |= rows["vehicle"] == "v1"  # and one of the others, which is too few
    (found,) = failure_rules(rows.assign(height_m=rows["height_m"].mask(tall, 2.0), score=np.where(tall, 0.2, 0.8)))
    table = rules_table([found])
    assert dict(zip(table.header, table.lines[0]))["other vehicles"] == "-0.60 (too few)" and not found.confirmed


def test_a_shape_of_another_kind_is_no_object_of_the_vehicle_that_the_search_began_at(sweep: Sweep) -> None:
    searched = sweep.solutions["method"] == "adversarial"
    solutions = sweep.solutions.assign(drawn_as=pd.Series("camper", sweep.solutions.index).where(searched))
    rows = rule_objects(dataclasses.replace(sweep, solutions=solutions))
    assert dict(zip(rows["method"], rows["vehicle"])) == {"baseline": "suv", "random": "suv", "adversarial": "camper"}


def test_too_few_scenes_are_said() -> None:
    with pytest.raises(InputError, match=r"7 scenes.*scenes\.count=8"):
        failure_rules(objects(scenes=7))


def test_a_rule_reads_as_a_sentence_of_units() -> None:
    rule = FailureRule((Condition("height_m", high=1.35), Condition("aspect_deg", 70.4), Condition("range_m", 25, 35)))
    assert rule_text(rule) == "height at most 135 cm, angle to the line of sight over 70°, range 25 m to 35 m"


def test_the_objects_of_a_sweep_have_their_own_sizes_and_those_of_a_pose_the_vehicles(sweep: Sweep) -> None:
    rows = rule_objects(sweep)
    assert len(rows) and not rows.duplicated(["task_id", "scored_by", "method", "replicate"]).any()
    shapes = sweep.shapes.set_index(["task_id", "method", "replicate"])["length_m"].to_dict()
    for row in rows.itertuples():
        key = (row.task_id, "baseline", 0) if row.mode == "pose" else (row.task_id, row.method, row.replicate)
        expected = shapes.get(key, math.nan)
        assert row.length_m == expected or (math.isnan(row.length_m) and (expected is None or math.isnan(expected)))
    assert rows["aspect_deg"].between(0, 90).all()


def test_an_object_that_is_missed_under_two_effects_is_two(sweep: Sweep) -> None:
    """An object may have another score under each effect: otherwise misses would count for less than detections."""
    again = sweep.scores.assign(task_id="again-" + sweep.scores["task_id"])
    scores = pd.concat([sweep.scores, again], ignore_index=True)
    tasks = SimpleNamespace(effects_requested_of=lambda ids: [["fog" if "again" in task else "none"] for task in ids])
    both = dataclasses.replace(sweep, plan=SimpleNamespace(tasks=tasks), scores=scores)  # type: ignore[arg-type]
    assert len(rule_objects(both)) == 2 * len(rule_objects(sweep))


def test_what_tasks_share_and_what_no_step_changed_is_one_object(sweep: Sweep) -> None:
    searched = sweep.scores["method"] == "adversarial"
    again = sweep.scores.assign(task_id="again-" + sweep.scores["task_id"])
    lower = again.assign(score=again["score"].where(~searched, 0.9 * again["score"]))
    ids = sweep.plan.tasks.ids.to_pylist()
    twice = sweep.plan.tasks.select([*range(len(ids))] * 2)
    twice = dataclasses.replace(twice, ids=pa.array([*ids, *(f"again-{task}" for task in ids)]))
    plan = dataclasses.replace(sweep.plan, tasks=twice)
    one, same, two = (
        rule_objects(dataclasses.replace(sweep, plan=plan, scores=scores))["method"].value_counts()
        for scores in (sweep.scores, *(pd.concat([sweep.scores, more], ignore_index=True) for more in (again, lower)))
    )
    assert same.to_dict() == one.to_dict()
    assert two["baseline"] == one["baseline"] and two["adversarial"] == 2 * one["adversarial"]
    rows = sweep.scores.set_index(["task_id", "scored_by", "method", "replicate"])
    pose = ["score", "x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad"]
    for task, by in rows.loc[(slice(None), slice(None), "adversarial"), :].index.droplevel([2, 3]):
        rows.loc[(task, by, "adversarial", 0), pose] = rows.loc[(task, by, "baseline", 0), pose].to_numpy()
    unchanged = dataclasses.replace(
        sweep,
        scores=rows.reset_index()[sweep.scores.columns],
        shapes=sweep.shapes[sweep.shapes["method"] == "baseline"].assign(**dict.fromkeys(SIZES, math.nan)),
    )
    assert "adversarial" not in set(rule_objects(unchanged)["method"])
