"""The measured impact of effects: paired over the same objects, with intervals, and the choices of effects=auto."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import valid_sweeps

from shift3d.analysis.html.sections.effects import write_effects_page
from shift3d.analysis.statistics.intervals import mean_interval
from shift3d.analysis.tables.effects import effect_impacts, effect_milliseconds, effect_table, write_impact
from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.store.tables import table_from_rows, write_table

SCENES = [f"street-{number}" for number in range(12)]


def tables(changes: dict[str, np.ndarray], milliseconds: dict[str, float]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return scores of one vehicle in 12 scenes: without effects (0.5, adversarial 0.2), and changed by each effect."""
    scores, timings = [], []
    for effect, change in {"": np.zeros(len(SCENES)), **changes}.items():
        for scene, moved in zip(SCENES, change, strict=True):
            task = f"{effect}-{scene}"
            same = {"vehicle": "suv", "dataset": "street", "mode": "shape", "lambda": 1.0, "alpha": 0.01}
            same |= {"x_m": 20.0, "y_m": 1.0, "yaw_rad": 0.5}
            same |= {
                "detector": "p",
                "accuracy": "standard",
                "search": "descent",
                "scored_by": "p",
                "replicate": 0,
                "task_id": task,
            }
            for method, score in (("baseline", 0.5), ("adversarial", 0.2), ("random", 0.9)):
                effects = [effect] if effect else []
                scores.append({**same, "scene": scene, "method": method, "score": score + moved, "effects": effects})
            timings.append({"task_id": task, "method": "baseline", "stage": "render", "milliseconds": 100.0})
            if effect:
                stage = f"effect_{effect}"
                timings.append(
                    {"task_id": task, "method": "baseline", "stage": stage, "milliseconds": milliseconds[effect]}
                )
    return pd.DataFrame(scores), pd.DataFrame(timings)


def test_changes_are_paired_and_absolute_and_auto_follows_the_bound() -> None:
    wobble = np.where(np.arange(12) % 2, 0.1, -0.1)
    scores, timings = tables({"fog": wobble, "range_noise": np.full(12, 1e-3)}, {"fog": 20.0, "range_noise": 3.0})
    found = effect_impacts(scores, effect_milliseconds(scores, timings))
    fog, noise = found
    assert (fog.effect, fog.scenes, fog.objects) == ("fog", 12, 12)
    assert fog.score_change.mean == pytest.approx(0.1) and fog.auc_baseline.mean == pytest.approx(0.0, abs=1e-12)
    assert fog.auc_adversarial is not None and fog.auc_adversarial.low < 0.0 < fog.auc_adversarial.high
    assert (fog.milliseconds, noise.milliseconds) == (pytest.approx(20.0), pytest.approx(3.0))
    assert fog.measured.matters and not noise.measured.matters
    assert "left out" in str(effect_table(found)).splitlines()[-1]


def test_replicates_are_paired_with_those_at_their_own_place() -> None:
    scores, timings = tables({"fog": np.full(12, 1e-3)}, {"fog": 1.0})
    other = scores.assign(task_id=scores["task_id"] + "-1", x_m=30.0, score=scores["score"] + 0.4)
    (fog,) = effect_impacts(pd.concat([scores, other]), effect_milliseconds(scores, timings))
    assert (fog.scenes, fog.objects) == (12, 24)
    assert fog.score_change.mean == pytest.approx(1e-3) and not fog.measured.matters
    with pytest.raises(InputError, match="objects have several partners"):
        effect_impacts(pd.concat([scores, other.assign(x_m=20.0)]), {})


def test_times_of_many_places_are_paired_without_making_every_combination() -> None:
    scores, timings = tables({"fog": np.full(12, 1e-3)}, {"fog": 7.0})
    parts = [
        (scores.assign(task_id=scores["task_id"] + f"-{n}", x_m=20.0 + n, y_m=float(n), yaw_rad=0.01 * n, **more),
         timings.assign(task_id=timings["task_id"] + f"-{n}"))
        for n in range(40) for more in ({"mode": "pose", "lambda": np.nan} if n % 2 else {},)
    ]  # fmt: skip
    found = effect_milliseconds(*(pd.concat(part) for part in zip(*parts)))
    assert found == {"fog": pytest.approx(7.0)}


def test_a_baseline_that_tasks_share_has_its_time_whichever_of_them_spent_it() -> None:
    """A worker renders the shared baseline for its first task, which may be a different task under another effect."""
    scores, timings = tables({"fog": np.zeros(12)}, {"fog": 7.0})
    pose = scores.assign(task_id="pose-" + scores["task_id"], mode="pose", **{"lambda": np.nan})
    fog = timings["task_id"].str.startswith("fog-")
    spent = timings.assign(task_id=timings["task_id"].where(fog, "pose-" + timings["task_id"]))
    assert effect_milliseconds(pd.concat([scores, pose]), spent) == {"fog": pytest.approx(7.0)}


def test_one_scene_says_nothing_so_the_effect_stays() -> None:
    scores, timings = tables({"fog": np.full(12, 1e-3)}, {"fog": 1.0})
    (fog,) = effect_impacts(scores[scores["scene"] == SCENES[0]], effect_milliseconds(scores, timings))
    assert fog.score_change.high == np.inf and fog.measured.matters


def test_a_sweep_without_pairs_is_refused() -> None:
    scores, _ = tables({"fog": np.zeros(12)}, {"fog": 1.0})
    with pytest.raises(InputError, match=r"with exactly one effect.*sweeps/effects\.yaml"):
        effect_impacts(scores[scores["effects"].map(len) == 0], {})
    apart = scores[(scores["scene"] == SCENES[0]) ^ (scores["effects"].map(len) == 0)]
    with pytest.raises(InputError, match="scored both with fog and without"):
        effect_impacts(apart, {})


def test_page_and_what_auto_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from shift3d.effects import applicability

    scores, timings = tables({"fog": np.full(12, 0.2)}, {"fog": 20.0})
    found = effect_impacts(scores, effect_milliseconds(scores, timings))
    text = write_effects_page(tmp_path / "effects.html", "effects", found).read_text()
    assert "fog: 0.200 for 20 ms" in text and "data:image/png" in text
    monkeypatch.setattr(applicability, "MEASURED_IMPACT", write_impact(tmp_path / "impact.json", "effects", found))
    applicability.measured_impact.cache_clear()
    try:
        assert applicability.measured_impact()["fog"].score_change == 0.2
    finally:
        applicability.measured_impact.cache_clear()
    assert json.loads((tmp_path / "impact.json").read_text())["effects"]["fog"]["objects"] == 12


def test_an_effect_without_a_time_is_shown_and_never_adopted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A sweep that took its tasks over with reuse= lacks the time of a baseline that another task rendered."""
    from shift3d.effects import applicability

    scores, timings = tables({"fog": np.full(12, 0.2)}, {"fog": 20.0})
    given = {"scores": scores, "timings": timings[timings["task_id"].str.startswith("fog")].assign(calls=1)}
    valid_sweeps.write_sweep(tmp_path / "sweep")
    for name, frame in given.items():
        row = valid_sweeps.rows(name, valid_sweeps.plan().tasks[0])[0]
        table = table_from_rows(name, [row | own for own in frame.to_dict("records")])
        write_table(tmp_path / "sweep" / "final" / f"{name}.parquet", table)
    adopted = tmp_path / "impact.json"
    monkeypatch.setattr(applicability, "MEASURED_IMPACT", adopted)
    assert main(["effects", str(tmp_path / "sweep")]) == 0
    line, page = capsys.readouterr().out.splitlines()[3], (tmp_path / "sweep" / "final" / "effects.html").read_text()
    assert line.split()[-2:] == ["-", "yes"] and "fog: 0.200 for - ms" in page
    assert main(["effects", str(tmp_path / "sweep"), "--adopt"]) == 2 and not adopted.exists()
    assert "has no time of fog" in capsys.readouterr().err


@pytest.mark.filterwarnings("error")
def test_the_page_has_effects_without_a_time_beside_others_and_effects_of_one_scene(tmp_path: Path) -> None:
    scores, timings = tables({"fog": np.full(12, 0.2), "rain": np.full(12, 0.1)}, {"fog": 20.0, "rain": 30.0})
    untimed = effect_impacts(scores, {"rain": 30.0})
    one_scene = effect_impacts(scores[scores["scene"] == SCENES[0]], effect_milliseconds(scores, timings))
    text = write_effects_page(tmp_path / "effects.html", "effects", untimed).read_text()
    assert "fog: 0.200 for - ms; rain: 0.100 for 30 ms" in text
    assert "(one scene)" in write_effects_page(tmp_path / "effects.html", "effects", one_scene).read_text()


def test_the_interval_covers_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    groups = np.repeat(np.arange(200), 3)
    held = 0
    for _ in range(150):
        values = rng.normal(size=200)[groups] + 0.3 * rng.normal(size=600)  # scenes differ more than objects of one
        interval = mean_interval(values, list(groups))
        held += interval.low <= 0.0 <= interval.high
    assert abs(held / 150 - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 150)


def test_resampling_single_objects_would_have_promised_too_much() -> None:
    values = np.repeat(np.linspace(-1, 1, 10), 20)
    by_scene = mean_interval(values, list(np.repeat(np.arange(10), 20)))
    by_object = mean_interval(values, list(range(200)))
    assert by_scene.high - by_scene.low > 3 * (by_object.high - by_object.low)


def test_other_detectors_and_further_lambdas_add_no_object() -> None:
    scores, _ = tables({"fog": np.full(12, 0.02)}, {"fog": 20.0})
    none = scores["effects"].map(len) == 0
    others = scores.assign(scored_by="q", score=scores["score"].where(none, scores["score"] - 0.02))
    ten = scores.assign(**{"lambda": 10.0, "task_id": "ten-" + scores["task_id"]})
    (alone,), (among,) = (effect_impacts(rows, {}) for rows in (scores, pd.concat([scores, others, ten])))
    assert (among.objects, among.score_change) == (alone.objects, alone.score_change) == (12, alone.score_change)
    assert among.auc_adversarial is not None and among.auc_adversarial.mean == pytest.approx(0.02)
