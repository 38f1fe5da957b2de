"""Answers are the same from any process and after any number of interruptions."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from suites_by_hand import PER_SCENE, SCENES, write_detector, write_suite

from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.store.resolve import as_location
from shift3d.suite.frozen import FrozenSuite, read_suite
from shift3d.suite.scoring import Scorer, score_suite


@pytest.fixture
def suite(tmp_path: Path) -> FrozenSuite:
    write_suite(tmp_path / "suite")
    return read_suite(tmp_path / "suite")


@pytest.fixture
def scorer(tmp_path: Path) -> Scorer:
    module, weights = write_detector(tmp_path)
    return Scorer("own", weights, module)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("[!.]*") if path.is_file()}


def test_two_workers_and_a_second_call_give_the_bytes_of_one(
    suite: FrozenSuite, scorer: Scorer, tmp_path: Path
) -> None:
    tables = list(score_suite(suite, scorer, as_location(tmp_path / "one")))
    assert [len(table) for table in tables] == [2 * PER_SCENE] * SCENES
    found = [key for table in tables for key in table["object_id"]]
    assert found == list(suite.objects["object_id"])
    scores = {round(score, 3) for table in tables for score in table["score"]}
    assert len(scores) > SCENES and all(0.0 < score < 1.0 for score in scores)
    list(score_suite(suite, scorer, as_location(tmp_path / "two"), workers=2))
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


def test_an_interrupted_scoring_goes_on_where_it_stopped(suite: FrozenSuite, scorer: Scorer, tmp_path: Path) -> None:
    begun = score_suite(suite, scorer, as_location(tmp_path / "begun"))
    next(begun), next(begun)
    begun.close()
    known = contents(tmp_path / "begun")
    assert len(known) == 2
    # A known answer is not computed again: the same bytes, although its scenes are gone.
    for name in known:
        (tmp_path / "suite" / "backgrounds" / name).unlink()
    list(score_suite(suite, scorer, as_location(tmp_path / "begun")))
    assert len(contents(tmp_path / "begun")) == SCENES and known.items() <= contents(tmp_path / "begun").items()


def test_a_background_that_is_gone_or_torn_is_named(suite: FrozenSuite, scorer: Scorer, tmp_path: Path) -> None:
    file = next((tmp_path / "suite" / "backgrounds").iterdir())
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(InputError, match=file.name):
        list(score_suite(suite, scorer, as_location(tmp_path / "out")))
    file.unlink()
    with pytest.raises(InputError, match=f"{file.name}: is missing"):
        list(score_suite(suite, scorer, as_location(tmp_path / "out")))


@pytest.mark.parametrize("workers", [1, 2])
def test_an_object_on_which_the_detector_fails_is_named(suite: FrozenSuite, tmp_path: Path, workers: int) -> None:
    module = Path(write_detector(tmp_path)[0])
    fails = "    def model(points):\n        assert len(points) != 301, 'odd'\n"
    module.write_text(module.read_text().replace("    def model(points):\n", fails))
    first = suite.objects.iloc[0]
    with pytest.raises(InputError) as refused:
        list(score_suite(suite, Scorer("own", None, str(module)), as_location(tmp_path / "out"), workers))
    assert f"odd, at object {first['object_id'][:12]} in scene {first['scene']}" in str(refused.value)


def test_a_killed_gate_leaves_what_it_scored_and_ends_as_one_that_was_not(tmp_path: Path) -> None:
    write_suite(tmp_path / "suite", scored_by="own")
    module, _ = write_detector(tmp_path)
    # A detector slow enough to be killed between two scenes.
    slow = "import os, time\n        time.sleep(float(os.environ.get('SLOW_S', 0)))"
    source = Path(module).read_text().replace("    def model(points):\n", f"    def model(points):\n        {slow}\n")
    Path(module).write_text(source)
    out = tmp_path / "killed"
    words = [
        f"suite={tmp_path / 'suite'}",
        "detector=own",
        f"module={module}",
        f"out={out}",
        "accept=true",
        "mlflow=none",
    ]
    command = [sys.executable, "-m", "shift3d", "gate", *words]
    known = {**os.environ, "SLOW_S": "0.05"}
    process = subprocess.Popen(command, env=known, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    while not list(out.glob("answers-*/[!.]*.parquet")):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    (answers,) = out.glob("answers-*")
    left = contents(answers)
    assert 1 <= len(left) < SCENES and not (tmp_path / "suite" / "releases").exists()
    assert not (out / "verdict.json").exists()
    code = main(["gate", *words])
    assert left.items() <= contents(answers).items() and len(list(answers.iterdir())) == SCENES
    resumed = contents(out)
    assert main(["gate", *[word for word in words if word[:4] != "out="], f"out={tmp_path / 'whole'}"]) == code
    assert contents(tmp_path / "whole" / answers.name) == contents(answers)
    assert contents(tmp_path / "whole") == resumed
