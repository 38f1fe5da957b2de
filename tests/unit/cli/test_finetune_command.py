"""``shift3d finetune``: its words, the commands that it runs, and scenes that it refuses."""

from __future__ import annotations

import argparse
import os
import shutil
import signal
from pathlib import Path

import pytest

from shift3d.cli.command import Command
from shift3d.cli.commands.detectors import finetune
from shift3d.cli.commands.detectors.finetune import PipelineStep, read_request, run_step
from shift3d.cli.main import main
from shift3d.detectors.models.weights import WEIGHTS_FOLDER
from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode
from shift3d.signals import handle_stop_signals
from shift3d.training.provenance import write_provenance

LOCAL = ("runner=local", "tracking=none", "scenes.count=1", "scenes.sensor=hdl64", "scenes.traffic=family",
         "vehicle=suv")  # fmt: skip


@pytest.mark.parametrize("stops", [False, True])
def test_a_step_that_was_asked_to_stop_is_the_last_though_it_came_to_its_end(
    stops: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stopped sweep, too, finishes the tasks in flight, and is done if they are the last ones."""

    def run(arguments: argparse.Namespace) -> int:
        with handle_stop_signals(lambda *_: None):
            if stops:
                os.kill(os.getpid(), signal.SIGTERM)
        return int(ExitCode.DONE)

    step = PipelineStep(Command("sweep", "", "", run, words="words"), ["finetune"])
    assert run_step(step) == (ExitCode.INTERRUPTED if stops else ExitCode.DONE)
    assert capsys.readouterr().out == "\n$ shift3d sweep finetune\n"


def test_words_go_to_the_sweeps_that_they_are_for() -> None:
    request = read_request(
        ["size=small", "seeds=0,2", "rate=3e-5", "vehicle=suv", "held_out.scenes.count=4", "others=camper"]
    )
    assert (request.seeds, request.rate, request.streets, request.control) == ([0, 2], "3e-5", 50, False)
    assert request.overrides_of("finetune") == ["size=small", "vehicle=suv"]
    assert request.overrides_of("finetune_held_out") == ["size=small", "vehicle=suv", "scenes.count=4"]
    assert request.overrides_of("finetune_other_vehicles") == ["size=small", "scenes.count=4", "vehicle.name=camper"]
    plain = read_request([])
    assert (plain.seeds, plain.streets, plain.adaptive) == ([0, 1, 2], 200, True)
    assert not read_request(["adaptive=false"]).adaptive


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("seeds=0,0", "no different whole numbers"),
        ("seeds=0,00", "no different whole numbers"),
        ("seeds=a", "no different whole numbers"),
        ("streets=0", "not a whole number from 1"),
        ("control=yes", "control='yes' is neither true nor false"),
        ("adaptive=1", "adaptive='1' is neither true nor false"),
        ("rate=", "rate= is empty"),
    ],
)
def test_unusable_words_are_refused(word: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_request([word])


def test_the_commands_in_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["finetune", "--steps", *LOCAL, "seeds=0,1", "control=true", f"out={tmp_path}"]) == 0
    lines = capsys.readouterr().out.strip().splitlines()
    assert all(line.startswith("shift3d ") for line in lines)
    names = [line.split()[1] for line in lines]
    vanilla = ["sweep", "verify", "sweep", "sweep", "evaluate"]
    assert names == vanilla + 2 * ["train", "evaluate", "sweep", "sweep"] + 2 * ["train", "evaluate"]
    trained = [line for line in lines if " train " in line]
    assert ["method=baseline" in line for line in trained] == [False, False, True, True]
    assert all(f"recipe.seed={seed} " in line for line, seed in zip(trained, (0, 1, 0, 1), strict=True))
    adaptive = [line for line in lines if "detector.weights=" in line]
    assert all(f"{tmp_path}/finetuned-{seed}/pointpillars.safetensors" in "".join(adaptive) for seed in (0, 1))
    assert not list(tmp_path.iterdir()), "nothing runs"


@pytest.mark.parametrize("words", [[], ["runner.address=auto", "runner.workers=64"]], ids=["private", "cluster"])
def test_detectors_are_measured_with_the_cpus_that_this_process_may_use(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    assert main(["finetune", "--steps", *LOCAL[1:], *words, f"out={tmp_path}"]) == 0
    measured = [line for line in capsys.readouterr().out.splitlines() if " evaluate " in line]
    assert measured and all(" workers=1 " in line for line in measured)


def test_scenes_that_are_trained_on_and_held_out_are_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*LOCAL, "scenes.split=val", f"out={tmp_path / 'out'}"]
    assert main(["finetune", *words]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "street-val-hdl64-000000" in line and "finetune_held_out share" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["rate=fast"], "recipe.peak_rate='fast'"),
        (["rate=0"], "peak_rate=0.0"),
        (["scenes.split=val", "held_out.scenes.split=test"], "contains street-val-hdl64-000000, a street of split val"),
        (["held_out.scenes.split=train", "held_out.scenes.weather=fog"], "share street-train-hdl64-000000-fog"),
    ],
)
def test_what_the_training_would_refuse_is_refused_before_anything_is_attacked(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["finetune", "--steps", *LOCAL, *words, f"out={tmp_path / 'out'}"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert message in line


@pytest.mark.parametrize("setting", ["detector.weights", "+detector.other_weights.pointpillars"])
def test_the_weights_that_are_attacked_are_those_that_are_tuned(
    setting: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A setting of weights by detector name serves sweeps of several detectors, and means the same for one."""
    weights = Path(shutil.copy(WEIGHTS_FOLDER / "pointpillars.safetensors", tmp_path))
    words = ["finetune", "--steps", *LOCAL, f"{setting}={weights}", f"out={tmp_path / 'out'}"]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(f"start_from={weights}" in line for line in lines if " train " in line)
    assert f"weights={weights}" in next(line for line in lines if " evaluate " in line)
    write_provenance(weights, {"finetuned_on": {"scenes": {"street-test-hdl64-000000": "aa"}}})
    assert main(words) == 2, "what is held out was trained on"
    assert f"{weights}: was fine-tuned on street-test-hdl64-000000" in capsys.readouterr().err


def test_it_is_one_detector_that_is_tuned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["finetune", *LOCAL, "detector=pointpillars,sst_small", f"out={tmp_path / 'out'}"]) == 2
    assert "several detectors are attacked" in capsys.readouterr().err
    own = ["detector=own", "detector.module=mine.py", "detector.scored_by=[]"]
    for words in (own, own[:1]):  # its files are not requested first
        assert main(["finetune", *LOCAL, *words, f"out={tmp_path / 'out'}"]) == 2
        assert "there is no training of own" in capsys.readouterr().err
    assert finetune.COMMAND.name == "finetune"
