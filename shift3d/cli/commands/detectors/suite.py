"""\
Freezes hard objects of a finished sweep in a folder or bucket: for each object its scene as detectors see it, its box,
pose and latent code, and the scores that the sweep's detectors gave it. The unchanged vehicle of each task is its
control. The manifest suite.json holds a digest of every file. shift3d gate scores new weights on the suite; it needs
neither the sweep nor its renderer.

examples:
  shift3d suite outputs/default-1a2b3c4d5e6f7a8b to=suites/first
  shift3d suite outputs/kitti-1a2b3c4d5e6f7a8b to=s3://BUCKET/suite count=1000 frames=referenced

Defaults: method=adversarial count=500 choose=random seed=0 controls=true frames=copied. choose=hardest takes the lowest
scores; some of them are low by chance and rise under any other weights. frames=referenced stores no scene, for data
whose licence forbids copies: the gate reads the data set again (root=PATH if it has moved), or generates the streets
again. The suite leaves out unstable solutions (run shift3d verify first) and unnatural shapes."""

from __future__ import annotations

import argparse
import shlex

from shift3d.cli.command import FINISHED_SWEEP_HELP, Command, choice, key_values, whole_number
from shift3d.cli.completion import key_words
from shift3d.methods import METHODS
from shift3d.wording import counted

_KEYS = ("to", "method", "count", "choose", "seed", "controls", "frames")
_VALUES = {
    "method": ("adversarial", *(method for method in METHODS if method != "adversarial")),
    "choose": ("random", "hardest"),
    "controls": ("true", "false"),
    "frames": ("copied", "referenced"),
}


def _run(arguments: argparse.Namespace) -> int:
    values = key_values(arguments.words, _KEYS, ("to",), "suite")
    given = {key: choice(values, key, allowed, "suite") for key, allowed in _VALUES.items()}
    seed = whole_number(values, "seed", 0, "suite", least=0)
    count = whole_number(values, "count", 500, "suite")
    from shift3d.analysis.statistics.loss import least_p_value
    from shift3d.analysis.statistics.releases import ReleaseRule
    from shift3d.processor import configure_runtime
    from shift3d.suite.freezing import freeze_suite
    from shift3d.suite.selection import SelectionRule

    configure_runtime()
    chosen = SelectionRule(given["method"], count, given["choose"], seed, given["controls"] == "true")  # type: ignore[arg-type]
    frozen = freeze_suite(arguments.out, values["to"], chosen, given["frames"])  # type: ignore[arg-type]
    suite, manifest = frozen.suite, frozen.suite.manifest
    size = sum((suite.folder / name).size() for name in manifest["files"]) / 1e6
    hard, controls, scenes = (manifest[name] for name in ("hard_objects", "control_objects", "scenes"))
    parts = [counted(hard, "hard object"), counted(controls, "control"), counted(scenes, "scene")]
    print(f"{suite.folder}: {', '.join(parts)}, {size:.1f} MB, digest {suite.digest}")
    if least_p_value(scenes) > ReleaseRule().level:
        print("a gate refuses this suite: with so few scenes no loss is significant. Freeze a sweep over five or more")
    for reason, number in frozen.left_out.items():
        print(f"left out: {number} {reason}")
    if frozen.unverified:
        print(f"not verified: {counted(frozen.unverified, 'hard object')}; shift3d verify {shlex.quote(arguments.out)}")
    if frozen.largest_difference is None:
        print("no object was scored again: the suite or all its scenes were there already")
    else:
        print(f"scored again: at most {frozen.largest_difference:.1e} off the sweep's scores")
    return 0


COMMAND = Command(
    "suite",
    "freeze hard objects of a sweep for gates",
    __doc__,
    _run,
    FINISHED_SWEEP_HELP,
    "to=DIR [method=M] [count=N] [choose=random|hardest] [seed=N] [controls=false] [frames=referenced]",
    complete=key_words(_KEYS, _VALUES),
)
