"""\
Scores weights on every object of a suite and compares them, object by object, with the last release of the same
detector: recall and mean score, of hard objects and of controls. Ends with a verdict and an exit code: 0 no loss
found, 6 worse. Writes gate.html (the objects that got worse, worst first, and the losses that the suite can show),
gate.parquet, verdict.json and an MLflow run (mlflow=none: no run). The same command resumes a killed gate.

examples:
  shift3d gate suite=suites/first detector=pointpillars                      the shipped weights
  shift3d gate suite=suites/first detector=pointpillars weights=FILE accept=true workers=2
  shift3d gate suite=s3://BUCKET/suite detector=own module=FILE.py weights=FILE
  shift3d gate suite=suites/first detector=openpcdet weights=FILE.pth config=FILE.yaml
  shift3d gate suite=suites/first detector=onnx file=FILE.onnx name=NAME       the deployed model

The last release is the last accepted one (in SUITE/releases or releases=DIR), else the weights of the suite's sweep.
accept=true makes the weights the next release if nothing got worse, accept=anyway in any case. against=N compares with
release N. name=NAME names the detector, so that detectors of one kind have separate releases; the default is the name
of the file of module=, config= or file=. A score above score_threshold=0.3 is a detection. The weights are worse if a
measure fell by tolerance=0.005 or more, and chance causes such a fall in at most level=0.05 of releases that are no
worse. root=PATH is the data set of a suite with frames=referenced. jobs/gate_ci.yaml runs the gate in CI;
docs/guides/gate.md says how many objects a suite needs."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from shift3d.cli.command import Command, choice, key_values, share, whole_number, writable_folder
from shift3d.cli.completion import key_words
from shift3d.cli.detector_arguments import DETECTOR_HELP, DETECTOR_KEYS, detector_files, detector_name
from shift3d.detectors.names import DETECTOR_NAMES, FOREIGN, ONNX, OWN

KEYS = (
    *("suite", "detector", *DETECTOR_KEYS, "name", "against", "accept", "releases"),
    *("score_threshold", "level", "tolerance", "workers", "root", "mlflow", "out"),
)
_VALUES = {"detector": (*DETECTOR_NAMES, *FOREIGN, OWN, ONNX), "accept": ("true", "anyway", "false")}
_STORE = "sqlite:///mlflow.db"


def _run(arguments: argparse.Namespace) -> int:
    values = key_values(arguments.words, KEYS, ("suite", "detector"), "gate")
    for key, allowed in _VALUES.items():
        choice(values, key, allowed, "gate")
    workers = whole_number(values, "workers", 1, "gate")
    against = whole_number(values, "against", 1, "gate") if "against" in values else None
    defaults = {"score_threshold": 0.3, "level": 0.05, "tolerance": 0.005}
    shares = {key: share(values, key, default, "gate") for key, default in defaults.items()}
    from shift3d.processor import configure_runtime

    configure_runtime()
    from shift3d.analysis.gate import GateSettings, run_gate
    from shift3d.analysis.mlflow.measurement_runs import mirror_gate
    from shift3d.analysis.mlflow.store_uri import check_store
    from shift3d.analysis.statistics.releases import ReleaseRule
    from shift3d.store.resolve import as_location
    from shift3d.suite.frozen import read_suite
    from shift3d.suite.releases import refuse_unknown_name
    from shift3d.suite.scoring import Scorer

    uri = values.get("mlflow", _STORE)
    if uri != "none":
        check_store(uri, "mlflow")
    suite = read_suite(values["suite"], values.get("root"))
    scorer = Scorer(values["detector"], *detector_files(values["detector"], values, "gate"))
    name = f"outputs/gate/{suite.digest[:8]}-{scorer.name}-{scorer.digest[:8]}"
    out = writable_folder(values.get("out", name))
    releases = as_location(values["releases"]) if "releases" in values else suite.folder / "releases"
    called = values.get("name", detector_name(values["detector"], values))
    if called and "name" not in values:
        refuse_unknown_name(suite, releases, f"{scorer.name}:{called}")
    accept: Any = values.get("accept", "false")
    if accept != "false":
        releases.check_writable("releases=DIR")  # checked before the scoring
    settings = GateSettings(ReleaseRule(**shares), workers, against, accept, called)
    outcome = run_gate(suite, scorer, releases, as_location(out), settings)
    print(outcome.text)
    if outcome.compared and uri != "none" and (problem := mirror_gate(out, uri)):
        print(f"warning: not in MLflow ({uri}): {problem}", file=sys.stderr)
    return int(outcome.exit_code)


COMMAND = Command(
    "gate",
    "compare new weights with the last release",
    __doc__,
    _run,
    words=f"suite=DIR detector=NAME {DETECTOR_HELP} [name=NAME] "
    "[accept=true] [against=N] [releases=DIR] [score_threshold=P] [level=P] [tolerance=P] [workers=N] [root=PATH] "
    "[mlflow=URI|none] [out=DIR]",
    complete=key_words(KEYS, _VALUES),
    resumes=True,
)
