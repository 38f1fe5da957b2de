"""\
Serves the MLflow runs of finished sweeps on 127.0.0.1: AUCs, settings and files side by side.

example:
  shift3d ui --port 5001"""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path

from shift3d.cli.command import Command
from shift3d.cli.outcomes import DEFAULT_STORE
from shift3d.errors import InputError


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--uri", default=DEFAULT_STORE, help="MLflow store that sweeps write to (%(default)s)")
    parser.add_argument("--port", type=int, default=5000, help="port on 127.0.0.1 (%(default)s); 0: any free port")


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.analysis.mlflow.server import HOST, open_port, serve
    from shift3d.analysis.mlflow.store_uri import check_store

    check_store(arguments.uri, "--uri")
    if arguments.uri.startswith("sqlite:///") and not Path(arguments.uri.removeprefix("sqlite:///")).exists():
        remedy = "Run a sweep first: shift3d sweep; or name the store of your sweeps: --uri URI"
        raise InputError("there is no run yet", where=arguments.uri, remedy=remedy)
    with open_port(arguments.port) as listening:
        port = listening.getsockname()[1]
        print(f"MLflow on http://{HOST}:{port}, ready in a few seconds (Ctrl-C stops it)", flush=True)
        with contextlib.suppress(KeyboardInterrupt):
            serve(arguments.uri, listening)
    return 0


COMMAND = Command(
    "ui",
    "compare sweeps in MLflow, on loopback",
    __doc__,
    _run,
    options=_options,
)
