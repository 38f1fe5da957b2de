"""``shift3d compile``: export a detector as an ONNX file."""

from __future__ import annotations

import argparse

from shift3d.cli.command import Command, key_values, local_path
from shift3d.cli.completion import key_words
from shift3d.detectors.names import DETECTOR_NAMES, ONNX_EXPORTABLE
from shift3d.errors import InputError

_KEYS = ("detector", "weights", "to")

_HELP = f"""\
Writes a detector of shift3d as an ONNX file. Input: points (N, 3), any N. Outputs: boxes (A, 7) and scores (A,), one
per proposal, before suppression (docs/guides/detectors.md). First compares the scores of the file and of the detector
on two streets, and writes nothing if they differ by more than 1e-3. {" and ".join(ONNX_EXPORTABLE)} can be compiled.
Needs: pip install 'shift3d[onnx]'.

examples:
  shift3d compile detector=pointpillars to=pointpillars.onnx
  shift3d compile detector=pointpillars weights=FILE.safetensors to=mine.onnx
  shift3d sweep smoke detector=onnx detector.file=pointpillars.onnx detector.original=pointpillars \\
    attack.search=evolution"""


def _run(arguments: argparse.Namespace) -> int:
    values = key_values(arguments.words, _KEYS, ("detector", "to"), "compile")
    if values["detector"] not in DETECTOR_NAMES:
        raise InputError(
            f"detector={values['detector']} cannot be compiled", "compile", f"One of: {', '.join(ONNX_EXPORTABLE)}"
        )
    target = local_path(values["to"], "to")
    if target.suffix != ".onnx":
        raise InputError(f"to={values['to']} does not end in .onnx", "compile", "Give to=FILE.onnx")
    from shift3d.store.atomic import check_writable, write_atomic

    check_writable(target.parent, "to=FILE.onnx")
    from shift3d.processor import configure_runtime
    from shift3d.settings.catalogue.compiled import export_onnx_detector

    configure_runtime()
    content, worst = export_onnx_detector(values["detector"], values.get("weights"))
    write_atomic(target, content)
    print(f"{target}: {len(content) / 2**20:.0f} MiB, scores within {worst:.1g} of {values['detector']}'s")
    return 0


COMMAND = Command(
    "compile",
    "write a detector as an ONNX file",
    _HELP,
    _run,
    words="detector=NAME to=FILE.onnx [weights=FILE]",
    complete=key_words(_KEYS, {"detector": ONNX_EXPORTABLE}),
)
