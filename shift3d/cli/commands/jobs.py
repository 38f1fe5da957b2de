"""\
Lists the launch specs: files that start a sweep on this machine, a Ray cluster, Kubernetes, Slurm or AWS, or a gate in
CI. NAME prints one of them; its first lines explain its use. Launch specs in jobs/ of the current folder come first.

examples:
  shift3d jobs                              the launch specs and their paths
  shift3d jobs kuberay > kuberay.yaml       a copy to fill in
  shift3d jobs slurm > slurm.sbatch && sbatch --nodes=4 slurm.sbatch default out=/shared/FOLDER tracking=none
  shift3d sweep default job=ray_cluster     job= accepts local, ray_cluster and ray_job by name"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from shift3d.cli.command import Command
from shift3d.errors import InputError
from shift3d.settings.folders import files, searched_folders_text, shown


def _names(prefix: str = "", **_: Any) -> list[str]:
    return [name for name in files("jobs", "*") if name.startswith(prefix)]


def _options(parser: argparse.ArgumentParser) -> None:
    name = parser.add_argument("name", nargs="?", metavar="NAME", help="launch spec to print")
    name.completer = _names  # type: ignore[attr-defined]


def _run(arguments: argparse.Namespace) -> int:
    found = files("jobs", "*")
    if arguments.name is None:
        print("\n".join(f"{name:<14} {_summary(path)}\n{'':<14} {shown(path)}" for name, path in found.items()))
        return 0
    path = found.get(Path(arguments.name).stem)
    if path is None:
        from shift3d.settings.messages import choice_error

        raise choice_error("job", arguments.name, found, "jobs", searched_folders_text("jobs"))
    try:
        print(path.read_text(), end="")
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read ({error})", where=shown(path), remedy="Restore it, or remove it") from error
    return 0


def _summary(path: Path) -> str:
    """Return the first sentence of a spec's leading comment, which describes the spec."""
    lines = path.read_text(errors="replace").splitlines()
    comment = next((line for line in lines if line.startswith("# ")), "")
    return comment.removeprefix("# ").split(". ")[0]


COMMAND = Command("jobs", "list the launch specs, or print one", __doc__, _run, options=_options)
