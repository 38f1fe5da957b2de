"""The command line: quick, teaching, and one line for what it cannot use."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest

from shift3d.cli.command import key_values
from shift3d.cli.completion import overrides, sweep_words
from shift3d.cli.main import COMMANDS, main, make_parser, parse
from shift3d.cli.words import split_words
from shift3d.errors import InputError
from shift3d.store.location import as_location


def test_help_imports_nothing_heavy_and_is_quick() -> None:
    heavy = "('torch', 'ray', 'mlflow', 'hydra', 'omegaconf', 'pandas', 'pyarrow', 'numpy', 'pydantic')"
    code = (
        "import sys, shift3d.cli.main as m\n"
        "try: m.main(['sweep', '--help'])\nexcept SystemExit: pass\n"
        f"sys.exit(str([name for name in {heavy} if name in sys.modules] or ''))"
    )
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.stderr.strip() in ("", "[]"), done.stderr
    # Time on the processor: what a user waits on a machine that does nothing else.
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 0.3


def test_help_of_every_command_has_an_example() -> None:
    for command in COMMANDS:
        assert "shift3d " in command.epilog, command.name
        assert command.name in make_parser().format_help()


def test_no_command_is_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert "examples:" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sweep", "defualt"], "Did you mean 'default'?"),
        (["plan", "vehicle=sub"], "Did you mean 'suv'?"),
        (["export", "nowhere", "task=ID", "method=random", "to=x"], "it has no spec.yaml"),
        (["export", "nowhere", "task=ID", "method=random"], "to= is missing"),
        (["export", "nowhere", "tusk=ID"], "cannot read 'tusk=ID'"),
        (["export", "nowhere", "task=ID", "method=random", "to=x", "replicate=a"], "is not a number"),
        (["train"], "model= is missing"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_used_is_one_line_and_exit_code_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert message in captured.err and len(captured.err.strip().splitlines()) == 1
    assert captured.err.startswith(f"shift3d {arguments[0]}: ")


def test_words_of_a_sweep() -> None:
    assert split_words([]) == ("default", [], None)
    assert split_words(["kitti", "scenes.root=a=b", "out=c d"]) == ("kitti", ["scenes.root=a=b"], as_location("c d"))
    assert split_words(["vehicle=suv"]) == ("default", ["vehicle=suv"], None)
    assert split_words(["+scenes.x=1"]) == ("default", ["+scenes.x=1"], None)


def test_words_may_stand_on_both_sides_of_an_option() -> None:
    parsed = parse(["sweep", "default", "a=1", "--task", "0f", "out=x"])
    assert (parsed.words, parsed.task) == (["default", "a=1", "out=x"], "0f")
    for wrong in (["sweep", "--tusk", "0f"], ["ui", "extra"]):
        with pytest.raises(SystemExit):
            parse(wrong)


def test_key_values() -> None:
    assert key_values(["a=1", "b=x=y"], ["a", "b"], ["a"], "here") == {"a": "1", "b": "x=y"}
    with pytest.raises(InputError, match="given twice"):
        key_values(["a=1", "a=2"], ["a"], [], "here")


def test_completion_offers_sweeps_groups_options_and_settings() -> None:
    assert "default" in sweep_words("") and sweep_words("kit") == ["kitti"]
    assert "vehicle=suv" in overrides("vehicle=") and "accuracy=_render" not in overrides("accuracy=")
    assert "attack.placement.min_range_m=" in overrides("attack.pl")
    assert "scenes.count=" in overrides("scenes.") and overrides("out") == ["out="]
    assert overrides("../x=") == []
