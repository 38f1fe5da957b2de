"""A gate ends with a verdict: the same weights pass, worse ones are stopped, and the history of releases is kept."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnxruntime
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from onnx_files import write_model
from suites_by_hand import PER_SCENE, SCENES, write_detector, write_suite

from shift3d.analysis.gate import Acceptance, GateOutcome, GateSettings, run_gate
from shift3d.analysis.statistics.loss import least_p_value
from shift3d.analysis.statistics.releases import ReleaseRule
from shift3d.analysis.tables.gate import compare
from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode
from shift3d.store.resolve import as_location
from shift3d.store.user_cache import program_digest, source_digest
from shift3d.suite.frozen import read_suite
from shift3d.suite.releases import last_release
from shift3d.suite.scoring import Scorer
from shift3d.suite.tables import suite_table_bytes


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_suite(tmp_path / "suite")
    return tmp_path


def gate(folder: Path, bias: float, accept: Acceptance = "false", **more: object) -> GateOutcome:
    module, weights = write_detector(folder, bias)
    suite, out = read_suite(folder / "suite"), as_location(folder / f"out{bias:g}")
    settings = GateSettings(accept=accept, **more)  # type: ignore[arg-type]
    return run_gate(suite, Scorer("own", weights, module), suite.folder / "releases", out, settings)


def releases(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "suite" / "releases").glob("[!.]*"))


def test_the_same_weights_pass_and_worse_ones_are_stopped(folder: Path) -> None:
    first = gate(folder, -2.0, "true")
    assert "the first" in first.text and not first.compared and releases(folder) == ["00000001.parquet"]
    same = gate(folder, -2.0, "true")
    assert same.exit_code == ExitCode.DONE and "already release 1, and" in same.text and not same.compared
    assert releases(folder) == ["00000001.parquet"], "the last release is not put in again"
    worse = gate(folder, -2.6, "true")
    assert worse.exit_code == ExitCode.WORSE and "Worse than release 1: " in worse.text
    assert "not accepted" in worse.text and releases(folder) == ["00000001.parquet"]
    better = gate(folder, -1.5, "true")
    assert better.exit_code == ExitCode.DONE and releases(folder) == ["00000001.parquet", "00000002.parquet"]
    # After a release better than the first one, that release is the last one; the first can still be named.
    assert gate(folder, -2.0).exit_code == ExitCode.WORSE
    assert gate(folder, -2.0, against=1).exit_code == ExitCode.DONE
    assert gate(folder, -2.6, "anyway").exit_code == ExitCode.WORSE and len(releases(folder)) == 3
    with pytest.raises(InputError, match="no release 9 of own"):
        gate(folder, -2.0, against=9)


def test_a_roll_back_is_the_last_release_from_then_on(folder: Path) -> None:
    gate(folder, -2.0, "true")
    gate(folder, -2.6, "anyway")
    back = gate(folder, -2.0, "true", against=1)
    assert "accepted as release 3" in back.text and len(releases(folder)) == 3
    assert gate(folder, -2.6).exit_code == ExitCode.WORSE, "it is compared with what was rolled back to"
    assert "accepted as release 3" in gate(folder, -2.0, "true", against=1).text and len(releases(folder)) == 3


@pytest.mark.parametrize(("bias", "accept"), [(-1.5, "true"), (-2.6, "anyway")])
def test_an_accepted_release_run_again_repeats_its_verdict(folder: Path, bias: float, accept: Acceptance) -> None:
    """The files compare with the release before, with or without accept=; an accepted release passes."""
    gate(folder, -2.0, "true")
    gate(folder, bias, accept)
    files = {path.name: path.read_bytes() for path in (folder / f"out{bias:g}").glob("gate.*")}
    verdict = (folder / f"out{bias:g}" / "verdict.json").read_bytes()
    assert json.loads(verdict)["facts"]["against"] == "release 1"
    again: tuple[Acceptance, ...] = ("false", "true", accept)
    for choice in dict.fromkeys(again):
        same = gate(folder, bias, choice)
        assert same.exit_code == ExitCode.DONE and "not accepted" not in same.text and "release 2" in same.text
        assert (folder / f"out{bias:g}" / "verdict.json").read_bytes() == verdict
        assert {path.name: path.read_bytes() for path in (folder / f"out{bias:g}").glob("gate.*")} == files
    assert len(releases(folder)) == 2
    worse = ExitCode.WORSE if bias < -2.0 else ExitCode.DONE
    assert gate(folder, bias, against=1).exit_code == worse, "the requested comparison is made"
    assert "with themselves" in gate(folder, bias, against=2).text, "they are compared with themselves if requested"


@pytest.mark.parametrize("what", ["some objects", "two weights"])
def test_a_sweep_that_scored_a_part_is_no_release(folder: Path, what: str) -> None:
    write_suite(folder / "suite", scored_by="own")
    suite, file = read_suite(folder / "suite"), folder / "suite" / "scores.parquet"
    history = as_location(folder / "suite" / "releases")
    found = last_release(suite, history, "own")
    assert found is not None and found.number == 0
    table = pq.read_table(file)
    if what == "some objects":
        table = table.slice(2)
    else:
        weights = table["weights"].to_pylist()
        at = table.column_names.index("weights")
        table = table.set_column(at, table.schema.field(at), pa.array(["other", *weights[1:]]))
    pq.write_table(table, file)
    assert last_release(suite, history, "own") is None


def test_detectors_of_one_kind_have_releases_of_their_own(folder: Path) -> None:
    """A detector that scores less than another of its kind is no worse release of that detector."""
    write_suite(folder / "suite", scored_by="own")
    suite = read_suite(folder / "suite")
    history = suite.folder / "releases"

    def last(name: str, **more: int) -> int | None:
        found = last_release(suite, history, f"own:{name}" if name else "own", **more)
        return None if found is None else found.number

    assert last("ours") == 0, "the sweep's weights, while no other has releases"
    gate(folder, 9.0, "true")  # of an older program: no name
    assert last("ours") == last("other") == last("") == 1
    gate(folder, 9.5, "true", name="ours")
    assert last("ours") == 2 and last("ours", number=1) == 1
    assert last("other") is None and last("") == 1
    assert "the first" in gate(folder, -2.0, "true", name="other").text
    assert gate(folder, -2.6, name="other").exit_code == ExitCode.WORSE
    assert (last("ours"), last("other")) == (2, 3)
    with pytest.raises(InputError, match="no release 2 of own:other"):
        last("other", number=2)


def test_a_damaged_answer_is_to_be_removed(folder: Path) -> None:
    gate(folder, -2.0, "true")
    (answers, *_) = sorted((folder / "out-2").glob("answers-*/*.parquet"))
    answers.write_bytes(b"PAR1")
    with pytest.raises(InputError, match="Remove the file: the next run scores"):
        gate(folder, -2.0, against=1)


def test_what_another_program_scored_is_scored_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gate(folder, -2.0, "true")
    assert gate(folder, -2.6).exit_code == ExitCode.WORSE
    for file in (folder / "out-2.6").glob("answers*/*.parquet"):  # like the files of a program with higher scores
        table = pq.read_table(file)
        file.write_bytes(suite_table_bytes(table.set_column(1, table.schema.field(1), pa.array([0.99] * len(table)))))
    assert gate(folder, -2.6).exit_code == ExitCode.DONE
    read = Path.read_bytes
    monkeypatch.setattr(
        Path, "read_bytes", lambda path: read(path) + b"#" * path.as_posix().endswith("detectors/nms.py")
    )
    monkeypatch.setattr("shift3d.store.user_cache.source_digest", source_digest.__wrapped__)
    monkeypatch.setattr("shift3d.analysis.gate.program_digest", program_digest.__wrapped__, raising=False)
    assert gate(folder, -2.6).exit_code == ExitCode.WORSE


def test_what_another_onnx_runtime_scored_is_scored_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, suite, out = write_model(folder / "mine.onnx"), read_suite(folder / "suite"), as_location(folder / "out")

    def answers() -> list[Path]:
        run_gate(suite, Scorer("onnx", str(file)), suite.folder / "releases", out, GateSettings(accept="anyway"))
        return list((folder / "out").glob("answers-*"))

    monkeypatch.setattr("shift3d.analysis.gate.program_digest", program_digest.__wrapped__)
    (own,) = answers()
    (folder / "suite" / "releases" / "00000001.parquet").unlink()
    monkeypatch.setattr(onnxruntime, "__version__", "0.0")
    assert own in (both := answers()) and len(both) == 2


def test_a_verdict_does_not_promise_to_find_what_cannot_be_lost() -> None:
    objects = pd.DataFrame({"object_id": [f"o{n}" for n in range(60)], "role": "hard", "task_id": "t", "method": "m"})
    objects = objects.assign(vehicle="suv", dataset="d", mode="shape", x_m=20.0, y_m=0.0, object_points=300)
    objects = objects.assign(scene=[f"s{n % 12}" for n in range(60)])
    missed = dict.fromkeys(objects["object_id"], 0.1)
    sentence = compare(objects, missed, missed, ReleaseRule()).sentence("release 1")
    assert "of which 0 were detected before, the gate can show no loss of recall" in sentence
    found = dict.fromkeys(objects["object_id"], 0.9)
    assert "if objects were independent" in compare(objects, found, found, ReleaseRule()).sentence("release 1")


def test_a_level_below_the_least_p_value_gives_no_verdict() -> None:
    assert least_p_value(5) == 1 / 32 and least_p_value(40) == 1e-4


def test_what_is_written_says_what_got_worse_worst_first(folder: Path) -> None:
    gate(folder, -2.0, "true")
    gate(folder, -2.6)
    table = pq.read_table(folder / "out-2.6" / "gate.parquet").to_pandas()
    assert len(table) == 2 * PER_SCENE * SCENES and (table["change"] < 0).all()
    lost = table["detected_before"] & ~table["detected"]
    assert 0 < lost.sum() < len(table) and lost[: lost.sum()].all(), "lost objects come first"
    assert table["change"][: lost.sum()].is_monotonic_increasing
    # A bias lowers every logit by the same amount.
    logit = np.log(table[["score_before", "score"]] / (1.0 - table[["score_before", "score"]]))
    assert np.allclose(logit["score"] - logit["score_before"], -0.6, atol=1e-4)
    verdict = json.loads((folder / "out-2.6" / "verdict.json").read_bytes())
    assert verdict["worse"] and verdict["objects"]["hard"]["number"] == PER_SCENE * SCENES
    assert verdict["objects"]["hard"]["lost"] + verdict["objects"]["control"]["lost"] == lost.sum()
    page = (folder / "out-2.6" / "gate.html").read_text()
    assert verdict["sentence"].split(";")[0].replace(">", "&gt;") in page
    places = [page.index(str(key)[:12]) for key in table["object_id"][:8]]
    assert places == sorted(places)
    assert "http" not in page.split("<script>")[0].replace("http-equiv", "")


def test_answers_of_other_weights_are_not_taken(folder: Path) -> None:
    gate(folder, -2.0, "true")
    (folder / "out-2").rename(folder / "out-2.6")
    with pytest.raises(InputError, match="other weights"):
        gate(folder, -2.6)


def test_without_a_release_there_is_nothing_to_compare_with(folder: Path) -> None:
    with pytest.raises(InputError, match="accept=true"):
        gate(folder, -2.0)
    write_suite(folder / "suite", scored_by="own")
    assert gate(folder, 5.0).exit_code == ExitCode.DONE, "the sweep's own scores are the first release"


def test_a_release_of_another_suite_is_refused(folder: Path) -> None:
    gate(folder, -2.0, "true")
    write_suite(folder / "suite", scenes=SCENES - 1)
    with pytest.raises(InputError, match="another suite"):
        gate(folder, -3.0)


def test_a_suite_of_too_few_scenes_gives_no_verdict(tmp_path: Path) -> None:
    write_suite(tmp_path / "suite", scenes=4, scored_by="own")
    with pytest.raises(InputError, match=r"4 scenes: no loss can be significant.* least level .* is 0\.0625"):
        gate(tmp_path, -2.0)
    write_suite(tmp_path / "suite", scenes=5, scored_by="own")
    assert gate(tmp_path, -9.0).exit_code == ExitCode.WORSE


def test_a_significant_loss_below_the_tolerance_is_not_called_no_loss(folder: Path) -> None:
    objects = read_suite(folder / "suite").objects
    before, after = (dict.fromkeys(objects["object_id"], score) for score in (0.8, 0.79))
    found = compare(objects, before, after, ReleaseRule(tolerance=0.05))
    assert not found.worse and found.sentence("release 1").startswith("No loss of 0.05 or more found against release 1")
    same = compare(objects, before, before, ReleaseRule(tolerance=0.05))
    assert same.sentence("release 1").startswith("No loss found against release 1")


def test_the_comparison_does_not_depend_on_the_objects_order(folder: Path) -> None:
    objects = read_suite(folder / "suite").objects
    rng = np.random.default_rng(0)
    before, after = (dict(zip(objects["object_id"], rng.random(len(objects)))) for _ in range(2))
    one, two = (
        compare(rows, before, after, ReleaseRule()) for rows in (objects, objects.sample(frac=1, random_state=1))
    )
    assert one.rows.equals(two.rows)
    assert [m.p_value for m in one.measures] == [m.p_value for m in two.measures]
    recall, counts = one.measures[0], one.counts("hard")
    hard = objects[objects["role"] == "hard"]["object_id"]
    assert recall.before == np.mean([before[key] > 0.3 for key in hard])
    assert recall.change.mean == pytest.approx((counts["gained"] - counts["lost"]) / len(hard))
