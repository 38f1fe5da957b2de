"""The command line: quick, instructive, and one line for unusable input."""

from __future__ import annotations

import os
import platform
import signal
import subprocess
import sys
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import get_args

import pytest

import shift3d
from shift3d.cli.command import Command, key_values
from shift3d.cli.commands.detectors import train
from shift3d.cli.completion import overrides, sweep_words
from shift3d.cli.main import COMMANDS, main, make_parser, parse
from shift3d.cli.mesh_arguments import FRAME_VALUES
from shift3d.cli.outcomes import mirror
from shift3d.cli.sweep_arguments import parse_name_and_overrides
from shift3d.cli.version import _commit
from shift3d.errors import InputError
from shift3d.settings.schema.config import MlflowConfig
from shift3d.store.resolve import as_location


@pytest.mark.parametrize("words", [["sweep", "--help"], ["--version"]], ids=" ".join)
def test_help_is_quick_as_it_imports_the_standard_library_alone(words: list[str]) -> None:
    code = (
        "import sys\nbefore = set(sys.modules)\nimport shift3d.cli.main as m\n"
        f"try: m.main({words})\nexcept SystemExit: pass\n"
        "print(*sorted(set(sys.modules) - before), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    imported = done.stderr.split()
    others = {name.split(".")[0] for name in imported} - sys.stdlib_module_names
    assert others == {"shift3d"}
    assert len(imported) < 200, "it imports more than it needs"


def test_the_version_names_what_a_report_needs(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["--version"]) == 0
    lines = capsys.readouterr().out.splitlines()
    own, python, *libraries = lines
    assert own.startswith(f"shift3d {shift3d.__version__}") and python == f"Python {platform.python_version()}"
    assert libraries == [f"{name} {metadata.version(name)}" for name in ("torch", "ray")]
    root = Path(__file__).parents[3]
    git = ["git", "-C", str(root), "rev-parse", "--short", "HEAD"]
    if (root / ".git").exists():
        assert f", commit {subprocess.check_output(git, text=True).strip()}" in own
    assert _commit(tmp_path) == "", "no checkout"


def test_help_of_every_command_has_an_example() -> None:
    for command in COMMANDS:
        assert "shift3d " in command.epilog, command.name
        assert command.name in make_parser().format_help()


def test_an_unknown_command_is_named_beside_the_one_that_is_meant(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["reprt", "outputs"], ["--version", "reprt"]):
        with pytest.raises(SystemExit) as stopped:
            parse(words)
        assert stopped.value.code == 2
        assert "unknown command 'reprt'. Did you mean 'report'? One of: sweep, plan," in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["status", "outputs/a"], "Did you mean 'sweep status'?"),
        (["verify"], "arguments are required: OUT\n"),
    ],
)
def test_what_is_missing_on_the_line_is_named(words: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parse(words)
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["sweep", "smoke", "--dryrun"], "unknown option '--dryrun' of sweep. Did you mean --dry-run? One of: --help,"),
        (["report", "outputs/a", "--case=8"], "unknown option '--case=8' of report. Did you mean --cases?"),
        (["ui", "extra"], "shift3d ui takes no further word: extra"),
    ],
)
def test_an_option_that_a_command_lacks_is_named_beside_those_it_has(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        parse(words)
    assert stopped.value.code == 2 and says in capsys.readouterr().err


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
@pytest.mark.parametrize(
    ("command", "says"), [("verify", "interrupted; the same command resumes"), ("gc", "interrupted")]
)
def test_an_interrupted_command_says_whether_it_resumes(command: str, says: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "spec.yaml")
    # A suite that a shell runs in the background ignores SIGINT, and its children would inherit that.
    running = subprocess.Popen(
        [sys.executable, "-m", "shift3d", command, str(tmp_path)],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    )
    with (tmp_path / "spec.yaml").open("w"):  # opens once the command reads the file
        running.send_signal(signal.SIGINT)
        assert running.wait(timeout=60) == 130
    assert running.stderr is not None and running.stderr.read() == f"shift3d {command}: {says}\n"


def test_memory_that_runs_out_is_one_line(tmp_path: Path) -> None:
    """The limit leaves room for Python files, none for the libraries."""
    code = """
import resource, sys
from shift3d.cli.main import main
size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (size + 2**24, size + 2**24))
sys.exit(main(["evaluate", "detector=sst_small", "count=1"]))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.startswith("shift3d evaluate: memory ran out. Close other")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_streams_that_the_parent_closed_are_dev_null(tmp_path: Path, closed: str) -> None:
    """A file that gets the number of a closed stream would hold messages of libraries."""
    code = (
        "import os, sys; from shift3d.cli.main import main; main(['--version'])\n"
        "numbers = [os.open(os.devnull, os.O_RDONLY) for _ in range(3)]\n"
        "print('x', file=sys.stdout), print('x', file=sys.stderr), sys.stderr.isatty()\n"
        "open('done', 'w').write(str(min(numbers)))"
    )
    command = f'"$0" -c "$1" {closed}'
    done = subprocess.run(["bash", "-c", command, sys.executable, code], cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0 and int((tmp_path / "done").read_text()) > 2


def test_a_path_that_the_terminal_cannot_show_is_printed_in_ascii(tmp_path: Path) -> None:
    folder = tmp_path / "\u00f1 \u8eca"
    command = [sys.executable, "-m", "shift3d", "sweep", "status", str(folder)]
    code = f"from shift3d.cli.main import _prepare_standard_streams as p; p(); print({str(folder)!r})"
    for words, stream in (([sys.executable, "-c", code], "stdout"), (command, "stderr")):
        environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
        done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert r"\xf1 \u8eca" in getattr(done, stream) and "Traceback" not in done.stderr


def test_no_command_is_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert "examples:" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sweep", "defualt"], "Did you mean 'default'?"),
        (["plan", "vehicle=sub"], "Did you mean 'suv'?"),
        (["export", "nowhere", "task=ID", "method=random", "to=x"], "it does not exist, or is empty"),
        (["export", "nowhere", "task=ID", "method=random"], "to= is missing"),
        (["report", __file__], "test_command_line.py: is a file, not the output folder of a sweep. Check the path"),
        (["export", "nowhere", "tusk=ID"], "cannot read 'tusk=ID'. Did you mean task=?"),
        (["export", "nowhere", "task=ID", "method=random", "to=x", "replicate=a"], "is not a whole number"),
        (["export", "nowhere", "task=ID", "method=random", "to=x", "replicate=²"], "is not a whole number"),
        (["fit", "car.glb", "unit=m", "out=x", "steps=²"], "is not a whole number"),
        (["train"], "model= is missing"),
        (
            ["compile", "detector=onnx", "to=a.onnx"],
            "detector=onnx cannot be compiled. One of: pointpillars, centerpoint",
        ),
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
    assert not captured.err.startswith(f"shift3d {arguments[0]}: {arguments[0]}: ")


def test_words_of_a_sweep() -> None:
    assert parse_name_and_overrides([]) == ("default", [], None)
    assert parse_name_and_overrides(["kitti", "scenes.root=a=b", "out=c d"]) == (
        "kitti",
        ["scenes.root=a=b"],
        as_location("c d"),
    )
    assert parse_name_and_overrides(["vehicle=suv"]) == ("default", ["vehicle=suv"], None)
    assert parse_name_and_overrides(["+scenes.x=1"]) == ("default", ["+scenes.x=1"], None)


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


def completed(line: str, folder: Path) -> set[str]:
    """Return the completions for the end of a line, as a shell with argcomplete's hook requests them."""
    completing = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": "\n"}
    # Without '=' and ':' among the word breaks, as in zsh: completions are whole words.
    completing |= {"_ARGCOMPLETE_COMP_WORDBREAKS": " \t\n", "_ARGCOMPLETE_STDOUT_FILENAME": str(folder / "answer")}
    subprocess.run([sys.executable, "-m", "shift3d"], env={**os.environ, **completing}, cwd=folder, check=True)
    return {word.strip() for word in (folder / "answer").read_text().splitlines() if not word.startswith("-")}


@pytest.fixture
def sweeps(tmp_path: Path) -> Path:
    for name in ("outputs/smoke-0123", "outputs/default-4567", "runs/a"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "spec.yaml").touch()
    (tmp_path / "outputs" / "frontier").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("sweep pl", {"plan"}),
        ("sweep st", {"status", "stability"}),
        ("sweep status ", {"outputs/smoke-0123", "outputs/default-4567"}),
        ("sweep status runs/", {"runs/a"}),
        ("sweep outputs/", {"outputs/smoke-0123", "outputs/default-4567", "outputs/frontier/"}),
        ("sweep plan smo", {"smoke"}),
        ("sweep smoke vehicle=su", {"vehicle=suv"}),
        ("sweep smoke reuse=outputs/d", {"reuse=outputs/default-4567"}),
        ("plan smo", {"smoke"}),
        ("plan pl", set()),
        ("verify o", {"outputs/smoke-0123", "outputs/default-4567"}),
        ("report outputs/s", {"outputs/smoke-0123"}),
        ("export outputs/smoke-0123 rep", {"replicate="}),
        ("export outputs/smoke-0123 method=adv", {"method=adversarial", "method=adversarial_noise"}),
        ("sweep smoke mode=", {"mode=shape", "mode=pose", "mode=shape_pose"}),
        ("sweep smoke scenes.weather=", {f"scenes.weather={kind}" for kind in ("dry", "rain", "fog", "snow")}),
        ("sweep smoke scenes.traffic=", {f"scenes.traffic={kind}" for kind in ("family", "wide", "held_out")}),
        ("sweep smoke scenes.skip_bad=", {"scenes.skip_bad=true", "scenes.skip_bad=false"}),
        ("sweep smoke attack.steps=", set()),
        ("verify outputs/smoke-0123 runner.w", {"runner.workers=", "runner.worker_memory_mb="}),
        ("patterns outputs/smoke-0123 runner=", {"runner=local", "runner=ray"}),
        ("retrieve outputs/smoke-0123 pool=outputs/s", {"pool=outputs/smoke-0123"}),
        ("retrieve outputs/smoke-0123 po", {"pool="}),
        ("compile detector=", {"detector=pointpillars", "detector=centerpoint"}),
        ("fit car.glb u", {"up=", "unit="}),
        ("fit car.glb up=+", {"up=+x", "up=+y", "up=+z"}),
        ("train mo", {"model="}),
        ("train model=s", {"model=sdf", "model=sst", "model=sst_small"}),
    ],
)
def test_the_shell_is_offered(line: str, offered: set[str], sweeps: Path) -> None:
    assert completed(f"shift3d {line}", sweeps) == offered


@pytest.mark.parametrize(
    "command", [command for command in COMMANDS if command.complete], ids=lambda command: command.name
)
def test_the_help_names_every_key_that_the_shell_is_offered(command: Command) -> None:
    assert command.complete is not None
    keys = [word for word in command.complete("") if word.endswith("=") and word not in overrides("")]
    text = " ".join((command.words, command.metavar, command.description, command.epilog))
    assert [key for key in keys if key not in text] == [], "name them in `words`, or in the description"


def test_what_is_offered_for_a_mesh_and_a_model_is_what_they_take() -> None:
    from shift3d.training.command import MODELS
    from shift3d.vehicles.mesh_frame import AXES, UNITS_M

    assert set(train._VALUES["model"]) == set(MODELS)
    assert {"forward": AXES, "up": AXES, "unit": tuple(UNITS_M)} == FRAME_VALUES


def test_the_values_that_comments_list_are_those_that_settings_take() -> None:
    from shift3d.attack.names import SearchName, SpaceName
    from shift3d.settings.schema.config import Config
    from shift3d.settings.schema.scenes import StreetConfig

    def offered(key: str) -> set[str]:
        return {word.partition("=")[2] for word in overrides(f"{key}=")}

    taken = {"attack.search": SearchName, "attack.space": SpaceName, "mode": Config.model_fields["mode"].annotation}
    streets = ("sensor", "split", "weather", "traffic", "beams")
    taken |= {f"scenes.{name}": StreetConfig.model_fields[name].annotation for name in streets}
    for key, annotation in taken.items():
        names = {name for part in (annotation, *get_args(annotation)) for name in get_args(part)}
        names = {name for name in names if isinstance(name, str)}
        assert offered(key) == names, f"{key}: the comment of its setting in conf/ lists its values: a | b"


def test_completion_offers_sweeps_groups_options_and_settings() -> None:
    assert "default" in sweep_words("") and sweep_words("kit") == ["kitti"]
    assert "vehicle=suv" in overrides("vehicle=") and "accuracy=_render" not in overrides("accuracy=")
    assert "attack.placement.min_range_m=" in overrides("attack.pl")
    assert "scenes.count=" in overrides("scenes.") and overrides("out") == ["out="]
    assert overrides("../x=") == []


@pytest.mark.parametrize(
    ("uri", "ending"),
    [
        ("sqlite:///mlflow.db", "; shift3d ui shows it"),
        ("sqlite:////team runs/a.db", "; shift3d ui --uri 'sqlite:////team runs/a.db' shows it"),
        ("https://mlflow.example", " in https://mlflow.example"),
    ],
)
def test_the_command_that_shows_a_run_names_its_store(
    uri: str, ending: str, capsys: pytest.CaptureFixture[str]
) -> None:
    tracking = MlflowConfig(kind="mlflow", uri=uri, experiment="shift3d")
    mirror(tracking, lambda *_: None, "smoke-1")
    assert capsys.readouterr().out.strip().endswith(ending)
