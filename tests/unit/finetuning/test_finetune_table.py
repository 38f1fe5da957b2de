"""AUC, gains and natural metrics by hand: means, pairs, seeds, intervals."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from shift3d.analysis.detector_evaluation import write_evaluation
from shift3d.evaluation.breakdown import AveragePrecisionDraws
from shift3d.evaluation.frames import DetectedFrame, FrameDetections, GroundTruth
from shift3d.finetuning.page import finetune_page, gains_table
from shift3d.finetuning.report import natural_areas
from shift3d.finetuning.table import ADAPTIVE, FINETUNE, TUNED, VANILLA, finetune_table, natural_rows, seed_means
from shift3d.training.detector.detect_scenes import SceneDetections, write_scene_detections

SCENES = 12


def scores(model: str, seed: float, objects: str, values: list[float]) -> pd.DataFrame:
    """Return scores of one object per scene."""
    rows = {"vehicle": "suv", "place": [f"street/{index}" for index in range(len(values))], "settings": "shape"}
    return pd.DataFrame({**rows, "score": values, "objects": objects, "model": model, "seed": seed}).assign(
        scene_set="held_out"
    )


def by_hand() -> pd.DataFrame:
    rng = np.random.default_rng(0)
    base, hard = 0.7 + 0.1 * rng.random(SCENES), 0.3 + 0.1 * rng.random(SCENES)
    parts = [scores(VANILLA, np.nan, kind, list(hard)) for kind in ("adversarial", ADAPTIVE)]
    parts += [scores(VANILLA, np.nan, "baseline", list(base))]
    for seed, gain in ((0, 0.04), (1, 0.08)):
        noise = 0.01 * rng.standard_normal(SCENES)
        parts += [scores(TUNED, seed, "adversarial", list(hard + gain + noise - noise.mean()))]
        parts += [scores(TUNED, seed, "baseline", list(base))]
        parts += [scores(TUNED, seed, ADAPTIVE, list(hard - 0.01)[:-2])]  # two scenes without a place
    return pd.concat(parts, ignore_index=True)


def row(table: pd.DataFrame, model: str, objects: str, seed: float = np.nan) -> pd.Series:
    own = table[(table["model"] == model) & (table["objects"] == objects)]
    own = own[own["seed"].isna() if np.isnan(seed) else own["seed"] == seed]
    assert len(own) == 1
    return own.iloc[0]


def test_an_auc_is_the_mean_score_and_a_gain_is_of_pairs() -> None:
    given = by_hand()
    table = finetune_table(given, []).to_pandas()
    for (model, objects, seed), own in given.groupby(["model", "objects", "seed"], dropna=False):
        found = row(table, model, objects, seed)
        assert found["value"] == pytest.approx(own["score"].mean()) and found["number"] == len(own)
        assert found["low"] <= found["value"] <= found["high"]
    for seed, gain in ((0, 0.04), (1, 0.08)):
        assert row(table, TUNED, "adversarial", seed)["gain"] == pytest.approx(gain)
    mean = row(table, TUNED, "adversarial")
    assert mean["gain"] == pytest.approx(0.06) and 0.05 < mean["gain_low"] < 0.06 < mean["gain_high"] < 0.07
    assert mean["high"] - mean["low"] > 3 * (mean["gain_high"] - mean["gain_low"]), "pairs know more than means"
    adaptive = row(table, TUNED, ADAPTIVE)
    assert adaptive["gain"] == pytest.approx(-0.01) and adaptive["number"] == SCENES - 2, "of what both were scored on"
    assert row(table, TUNED, "baseline")[["gain", "gain_low", "gain_high"]].tolist() == [0.0, 0.0, 0.0]
    assert table[table["model"] == VANILLA]["gain"].isna().all()


def test_a_mean_over_seeds_holds_objects_that_every_seed_has() -> None:
    given = by_hand()
    lacking = given.drop(given[(given["seed"] == 1) & (given["place"] == "street/3")].index)
    means = seed_means(lacking)
    assert "street/3" not in set(means["place"]) and means["seed"].isna().all()
    assert len(means[means["objects"] == "adversarial"]) == SCENES - 1


def test_objects_that_no_column_tells_apart_keep_their_mean_over_seeds() -> None:
    """Two objects have one vehicle, scene and settings, for example under attack.starts=1,8."""
    given = by_hand().query("objects != @ADAPTIVE")
    twice = pd.concat([given, given.assign(score=given["score"] - 0.1)], ignore_index=True)
    one, two = (finetune_table(rows, []).to_pandas() for rows in (given, twice))
    for seed in (0, 1, np.nan):
        found = row(two, TUNED, "adversarial", seed)
        assert found["gain"] == pytest.approx(row(one, TUNED, "adversarial", seed)["gain"])
        assert found["value"] == pytest.approx(row(one, TUNED, "adversarial", seed)["value"] - 0.05)


def test_a_single_scene_has_no_interval() -> None:
    one = by_hand().query("place == 'street/0'")
    table = finetune_table(one, []).to_pandas()
    assert table[["low", "high", "gain_low", "gain_high"]].isna().all().all() and table["value"].notna().all()


def areas(value: float | None, drawn: list[float]) -> dict[tuple[str, str], AveragePrecisionDraws]:
    return {("AP", "BEV"): AveragePrecisionDraws(value, drawn, 40), ("AP", "3D"): AveragePrecisionDraws(None, [], 0)}


def test_natural_gains_are_paired_over_the_same_draws() -> None:
    draws = list(np.linspace(0.7, 0.9, 101))
    measured = {
        (VANILLA, None): areas(0.80, draws),
        (TUNED, 0): areas(0.81, [value + 0.01 for value in draws]),
        (TUNED, 1): areas(0.83, [value + 0.03 for value in draws]),
    }
    rows = {(found["model"], found["seed"]): found for found in natural_rows(measured)}
    assert set(rows) == {(VANILLA, None), (TUNED, 0), (TUNED, 1), (TUNED, None)}, "what nobody could measure is no row"
    assert "gain" not in rows[VANILLA, None] and rows[VANILLA, None]["metric"] == "AP BEV"
    mean = rows[TUNED, None]
    assert mean["value"] == pytest.approx(0.82) and mean["gain"] == pytest.approx(0.02)
    assert (mean["gain_low"], mean["gain_high"]) == pytest.approx((0.02, 0.02)) and mean["high"] - mean["low"] > 0.15
    table = finetune_table(by_hand(), list(rows.values()))
    assert table.schema == FINETUNE and table.to_pandas()["objects"].isna().sum() == 4


def test_the_page_shows_both_models_beside_the_papers_figures() -> None:
    given = by_hand()
    natural = natural_rows({(VANILLA, None): areas(0.8, [0.7, 0.9]), (TUNED, 0): areas(0.81, [0.71, 0.91])})
    table = finetune_table(given, natural).to_pandas()
    printed = str(gains_table(table))
    lines = {tuple(line.split()[-4:]) for line in printed.splitlines()}
    assert ("paper", "0.482", "0.514", "+0.032") in lines and ("paper", "0.751", "0.774", "+0.023") in lines
    assert any("found against vanilla" in line and "+0.060" in line for line in printed.splitlines())
    source = {"objects": 3, "scenes": {"a": "h"}, "vehicles": {"suv": 3}, "left_out": {"unstable": 2}}
    made = {"finetuned_on": {**source, "sweep": "finetune", "spec_hash": "0f"}, "rate": 1e-4, "steps": 3,
            "started_from": {"file": "w.safetensors", "blake2b": "ab"}}  # fmt: skip
    page = finetune_page(table, given, made, ["shift3d sweep finetune <x>"])
    assert page == finetune_page(table, given, made, ["shift3d sweep finetune <x>"])
    assert "2 unstable" in page and "finetune &lt;x&gt;" in page and "0.514" in page
    assert set(re.findall(r'id="plot-(curve-\d)"', page)) == {"curve-0", "curve-1", "curve-2"}


def test_models_are_compared_over_the_scenes_that_they_were_last_evaluated_on(tmp_path: Path) -> None:
    """Both folders hold answers for all six scenes, of which the last three are misses.

    Another command with more streets evaluated the detector before on all six; the last run evaluated the one after on
    three, and an earlier run of it on more.
    """
    box = np.array([[10.0, 0.0, 0.8, 4.0, 1.8, 1.6, 0.0]])
    for model, evaluated in (("before", 6), ("after", 3)):
        answers = []
        for scene in range(6):
            truth = GroundTruth(box, np.array([50]), np.array([True]), np.array([-1]), ("Car",))
            found = FrameDetections(box + 30.0 * (scene >= 3), np.array([0.9]), np.array([True]), np.array([np.nan]))
            folder = tmp_path / model / "scenes"
            folder.mkdir(parents=True, exist_ok=True)
            answers.append(SceneDetections(DetectedFrame(str(scene), truth, found), 1.0, 1.0))
            write_scene_detections(folder / f"{scene}.npz", answers[-1])
        write_evaluation("sst", "street", answers[:evaluated], tmp_path / model)
    areas = natural_areas({(VANILLA, None): tmp_path / "before", (TUNED, 0): tmp_path / "after"})
    assert [row["value"] for row in natural_rows(areas)] == pytest.approx([1.0] * len(natural_rows(areas)))
    assert {row.get("gain") for row in natural_rows(areas)} <= {None, 0.0} and natural_rows(areas)
