"""Main program ``shift3d``: dispatch of the commands and reports of their failures."""

# PYTHON_ARGCOMPLETE_OK

from __future__ import annotations

import argparse
import difflib
import io
import os
import sys
import textwrap
from collections.abc import Sequence
from typing import NoReturn

from shift3d.cli.command import Command
from shift3d.cli.commands import compact, effects, fit, frontier, gc, jobs, plan, report, scenes, sweep, ui
from shift3d.cli.commands.detectors import compile, evaluate, finetune, gate, suite, train
from shift3d.cli.commands.follow_ups import export, patterns, retrieve, rules, verify
from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode, exit_codes

_MODULES = (sweep, plan, verify, report, rules, patterns, retrieve, scenes, effects, export, suite, gate, gc, compact,
            fit, train, finetune, evaluate, compile, frontier, ui, jobs)  # fmt: skip
COMMANDS: tuple[Command, ...] = tuple(module.COMMAND for module in _MODULES)

_DESCRIPTION = """\
Finds the blind spots of a LiDAR 3D detector: inserts a vehicle into a LiDAR scene and follows the
detector's gradient to a shape or a pose that the detector misses (SHIFT3D)."""

_EPILOG = f"""\
examples:
  shift3d sweep                          the paper's tables on procedural streets, into outputs/
  shift3d sweep smoke                    a trial of one minute; its numbers mean nothing
  shift3d sweep natural                  hard shapes that are vehicles
  shift3d sweep kitti scenes.root=PATH   the same tables on real KITTI frames
  shift3d plan default vehicle=suv       the tasks and their expected time; runs nothing
  shift3d verify outputs/default-1a2b3c4d5e6f7a8b
  shift3d export outputs/default-1a2b3c4d5e6f7a8b task=ID method=adversarial to=DIR

tab completion (bash, zsh):
  eval "$(register-python-argcomplete shift3d)"

{textwrap.fill(exit_codes(), 110)}"""


_RESUMES = "; the same command resumes"
_NO_MEMORY = ("failed to map segment", "can't allocate memory")
"""Words of an ImportError, from the loader of shared libraries, and of torch's RuntimeError."""


def make_parser() -> argparse.ArgumentParser:
    """Create the parser of all commands."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        prog="shift3d", description=_DESCRIPTION, epilog=_EPILOG, formatter_class=form, allow_abbrev=False
    )
    parser.add_argument("--version", action="store_true", help="print the versions that a bug report should name")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    for command in COMMANDS:
        sub = commands.add_parser(
            command.name,
            help=command.summary,
            description=command.description,
            epilog=command.epilog,
            formatter_class=form,
            allow_abbrev=False,
        )
        command.add_arguments(sub)
        sub.set_defaults(run=command.run, resumes=command.resumes)
    return parser


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse a command line. Words may precede and follow an option, which argparse alone does not allow."""
    parser = make_parser()
    if "_ARGCOMPLETE" in os.environ:
        import argcomplete

        argcomplete.autocomplete(parser)
    word = next((word for word in (sys.argv[1:] if arguments is None else arguments) if not word.startswith("-")), None)
    names = [command.name for command in COMMANDS]
    if word is not None and word not in names:
        close = difflib.get_close_matches(word, [*names, "sweep status"], n=1)
        hint = f"Did you mean {close[0]!r}? " if close else ""
        parser.error(f"unknown command {word!r}. {hint}One of: {', '.join(names)}")
    parsed, rest = parser.parse_known_args(arguments)
    if unknown := next((word for word in rest if word.startswith("-")), None):
        _refuse_option(parser, parsed.command, unknown)
    if rest and not hasattr(parsed, "words"):
        parser.error(f"shift3d {parsed.command} takes no further word: {' '.join(rest)}")
    if rest:
        parsed.words = [*parsed.words, *rest]
    return parsed


def _refuse_option(parser: argparse.ArgumentParser, name: str | None, option: str) -> NoReturn:
    """Exit with the options of a command and the closest match. name: the command; None for an option before it."""
    known = ["--help", "--version"]
    if command := next((command for command in COMMANDS if command.name == name), None):
        own = argparse.ArgumentParser(add_help=False)
        command.add_arguments(own)
        known = ["--help", *(word for action in own._actions for word in action.option_strings)]
    close = difflib.get_close_matches(option.partition("=")[0], known, n=1)
    hint = f"Did you mean {close[0]}? " if close else ""
    parser.error(f"unknown option {option!r} of {name or 'shift3d'}. {hint}One of: {', '.join(known)}")


def _prepare_standard_streams() -> None:
    """Open /dev/null as each standard stream that the parent process closed, and let stdout take any text.

    Else the next file that the program opens gets the stream's number, and messages of libraries go into that file. And
    a path that the encoding of stdout lacks would end a command after its work.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number: this one
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, "w" if number else "r", closefd=False))
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # as stderr


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code. An InputError becomes one line on stderr."""
    _prepare_standard_streams()
    parsed = parse(arguments)
    if parsed.version:
        from shift3d.cli.version import version_lines

        print(version_lines())
        return 0
    if parsed.command is None:
        make_parser().print_help()
        return 0
    try:
        return int(parsed.run(parsed))
    except InputError as error:
        return _report(error, parsed)
    except KeyboardInterrupt:
        print(f"shift3d {parsed.command}: interrupted{_RESUMES if parsed.resumes else ''}", file=sys.stderr)
        return int(ExitCode.INTERRUPTED)
    except BrokenPipeError:
        # The reader of the output (head, less) has closed the pipe, so no message can reach it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return int(ExitCode.NO_READER)
    except OSError as error:
        from shift3d.store.atomic import disk_error

        if (problem := disk_error(error)) is None:
            raise
        return _report(problem, parsed)
    except (MemoryError, ImportError, RuntimeError) as error:
        if not isinstance(error, MemoryError) and not any(words in str(error) for words in _NO_MEMORY):
            raise
        # No import here: it would fail, too.
        remedy = f"Close other programs, or raise the limit (ulimit -v){_RESUMES if parsed.resumes else ''}"
        print(f"shift3d {parsed.command}: memory ran out. {remedy}", file=sys.stderr)
        return int(ExitCode.UNUSABLE)


def _report(error: InputError, parsed: argparse.Namespace) -> int:
    from shift3d.store.atomic import DiskFullError

    resumes = ": it resumes" if isinstance(error, DiskFullError) and parsed.resumes else ""
    text = str(error).removeprefix(f"{parsed.command}: ")  # errors about words name the command as their place
    print(f"shift3d {parsed.command}: {text}{resumes}", file=sys.stderr)
    return int(error.exit_code)


if __name__ == "__main__":
    sys.exit(main())
