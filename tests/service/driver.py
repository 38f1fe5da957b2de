"""The shift3d command with the cheap task in place of the real one: fault tests run, start and kill it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

HERE = str(Path(__file__).resolve().parent)


def main(words: list[str]) -> int:
    from cheap_task import KIND

    from shift3d.cli.commands import sweep
    from shift3d.cli.main import parse
    from shift3d.errors import InputError

    try:
        return sweep.run_with(parse(words), KIND)
    except InputError as error:
        print(f"shift3d sweep: {error}", file=sys.stderr)
        return int(getattr(error, "exit_code", 2))


if __name__ == "__main__":
    sys.path.insert(0, HERE)
    # Ray's workers import the task by name.
    os.environ["PYTHONPATH"] = os.pathsep.join([HERE, os.environ.get("PYTHONPATH", "")])
    sys.exit(main(sys.argv[1:]))
