"""\
Measures every setting of sweeps/accuracy_time.yaml on the same beams in one run: hits missed and misplaced, depth
errors, errors of gradient and final score against the preset `reference`, and milliseconds. Writes frontier.parquet,
report.html, frontier.png and advice.txt to outputs/frontier/ or out=DIR, and prints the table and the advice.

The published method takes up to two minutes per rendering, the whole run at most 15 minutes on two idle cores.
The same command, without --again, resumes: it skips what the same code measured on the same machine. The command uses
one thread and measures the times of its own process: run nothing else on the machine.

examples:
  shift3d frontier                                    everything, on procedural streets
  shift3d frontier kitti=PATH                         also on real frames (twice the time); PATH holds training/
  shift3d frontier scenes=kitti scenes.root=PATH out=runs/frontier-kitti
  shift3d frontier --quick                            three minutes: one far vehicle, eleven settings, up to 3 times
  shift3d frontier --only 'standard|draft'            only these settings; no ratio to paper without paper
  shift3d frontier 'frontier.cases=[{vehicle:suv,range_m:20}]' frontier.repeats=15 --again

  python -c "import pandas; print(pandas.read_parquet('outputs/frontier/frontier.parquet'))\""""

from __future__ import annotations

import argparse
import re
import sys
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shift3d.cli.command import Command, writable_folder
from shift3d.cli.completion import key_words, overrides
from shift3d.cli.outcomes import mirror
from shift3d.cli.sweep_arguments import pop_folders
from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode
from shift3d.progress_bar import progress_bar
from shift3d.wording import counted

if TYPE_CHECKING:
    from shift3d.accuracy_time.drive import FrontierPlan, SceneGroup
    from shift3d.accuracy_time.settings import Setting
    from shift3d.settings.accuracy_time import FrontierSweepConfig

_NAME = "accuracy_time"
_WINDOW_M = 12.0  # detector window of the ground truth: wider than the window of any setting, whole scenes excepted
_KITTI_FRAMES = 30
_QUICK_REPEATS = 3


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--only", metavar="REGEX", help="measure only settings whose name matches")
    parser.add_argument("--quick", action="store_true", help="measure a few settings (frontier.quick) on one case")
    parser.add_argument("--again", action="store_true", help="measure everything again, except the ground truth")


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.analysis.mlflow.store_uri import check_tracking
    from shift3d.processor import configure_runtime

    configure_runtime()
    words = [re.sub(r"^kitti=", "frontier.kitti=", word) for word in arguments.words]
    out, words = pop_folders("out", words)
    config = _config(words)
    check_tracking(config.tracking)
    plan, left_out = plan_of(config, arguments.only, arguments.quick)
    # A partial frontier must not overwrite the full one.
    part = "-part" if arguments.only else "-quick" if arguments.quick else ""
    folder = writable_folder(str(out[-1]) if out else f"outputs/frontier{part}")
    for name in left_out:
        print(f"left out: {name} (this processor has no instructions for bfloat16)")
    try:
        _measure(config, plan, folder, arguments.again)
    except KeyboardInterrupt:
        without = " without --again" if arguments.again else ""
        print(f"interrupted: the same command{without} resumes", file=sys.stderr)
        return int(ExitCode.INTERRUPTED)
    if not part:
        from shift3d.analysis.mlflow.measurement_runs import mirror_frontier

        mirror(config.tracking, partial(mirror_frontier, folder))
    return 0


def _config(words: list[str]) -> FrontierSweepConfig:
    from shift3d.settings.accuracy_time import validate_frontier
    from shift3d.settings.compose import compose_sweep

    composed = compose_sweep(_NAME, words)
    if composed.axes:
        what = f"{composed.axes[0].key} has several values"
        raise InputError(what, f"sweep {_NAME}", "Give it one value: the command compares frontier.settings")
    return validate_frontier(composed.base, f"sweep {_NAME}")


def plan_of(config: FrontierSweepConfig, only: str | None, quick: bool) -> tuple[FrontierPlan, list[str]]:
    """Return the plan, and the names of settings left out for lack of bfloat16 instructions.

    Raises: InputError: an invalid pattern, or no setting left to measure.
    """
    from shift3d.accuracy_time.drive import FrontierPlan
    from shift3d.accuracy_time.run import RepeatLimits
    from shift3d.processor import has_fast_bfloat16
    from shift3d.settings.accuracy_time import expand_settings

    section = config.frontier
    written = expand_settings(section)
    chosen = [pair for pair in written if _matches(only, pair[0].name) and (not quick or pair[0].name in section.quick)]
    left_out = [setting.name for setting, _ in chosen if setting.bfloat16 and not has_fast_bfloat16()]
    settings = tuple(_setting(*pair) for pair in chosen if pair[0].name not in left_out)
    if not settings and left_out:
        what = f"{', '.join(left_out)}: this processor has no instructions for bfloat16"
        raise InputError(what, "frontier", "Choose other settings")
    if not settings and quick:
        named = f"called like {only!r} " if only else ""
        raise InputError(f"no setting {named}is in frontier.quick", "--quick", "Leave --quick out, or add it there")
    if not settings:
        raise InputError(f"no setting is called like {only!r}", "--only", "See sweeps/accuracy_time.yaml")
    cases, repeats, steps = section.cases, section.repeats, section.descent_steps
    if quick:
        cases = sorted(cases, key=lambda case: -case.range_m)[: section.quick_cases]
        settings = tuple(replace(setting, displaced=False, steps=1, attack_steps=0) for setting in settings)
        repeats, steps = min(repeats, _QUICK_REPEATS), 0
    plan = FrontierPlan(
        settings=settings,
        cases=tuple((case.vehicle, case.range_m) for case in cases),
        reference=_preset("reference", _WINDOW_M),
        search=_preset("standard", _WINDOW_M),
        repeats=RepeatLimits(repeats, section.seconds, section.slow_s),
        descent_steps=steps,
        warm_steps=section.warm_steps,
        within_m=section.within_m,
    )
    return plan, left_out


def _matches(pattern: str | None, name: str) -> bool:
    try:
        return pattern is None or re.search(pattern, name) is not None
    except re.error as error:
        raise InputError(f"{pattern!r} is no regular expression ({error})", "--only", "Quote it") from error


def _setting(setting: Any, accuracy: Any) -> Setting:
    """Convert a setting of the schema to a plain `Setting`."""
    from shift3d.accuracy_time.settings import Setting
    from shift3d.settings.catalogue.reading import accuracy_settings

    knob_name, values = next(iter(setting.over.items()), (None, [None]))
    own = {each.name for each in fields(Setting)} - {"preset"}
    preset = setting.preset if setting.name == setting.preset else None
    same: dict[str, Any] = {name: value for name, value in setting.model_dump().items() if name in own}
    accuracy = accuracy_settings(accuracy)
    return Setting(**same, accuracy=accuracy, knob=values[0], knob_name=knob_name, preset=preset)


def _preset(name: Any, crop_m: float) -> Setting:
    from shift3d.accuracy_time.settings import Setting
    from shift3d.settings.catalogue.reading import accuracy_settings
    from shift3d.settings.schema.config import AccuracyConfig

    return Setting(name, "presets", accuracy_settings(AccuracyConfig(name=name, render={})), crop_m=crop_m)


def groups_of(config: FrontierSweepConfig) -> list[SceneGroup]:
    """Return the sweep's scenes, and KITTI frames if requested. Raises: InputError: a folder without frames."""
    from shift3d.accuracy_time.drive import SceneGroup
    from shift3d.settings.catalogue.detector_files import detector_layouts
    from shift3d.settings.schema.scenes import KittiConfig, scene_set
    from shift3d.task.exchange import AssetsSpec
    from shift3d.task.spec import AttackSpec, PlacementSpec, TaskSpec

    scenes = [config.scenes]
    if config.frontier.kitti is not None:
        scenes.append(KittiConfig(kind="kitti", root=config.frontier.kitti, count=_KITTI_FRAMES, names=None))
    attack, section, groups = config.attack, config.frontier, []
    for chosen in scenes:
        centre, half_width = scene_set(chosen).placement_sector_rad
        placement = attack.placement.model_dump() | {"min_object_points": section.min_object_points}
        spec = TaskSpec(
            vehicle="",
            scene="",
            dataset="",
            mode="shape",
            lambda_=float(attack.lambda_),
            alpha=float(attack.alpha),
            detector=config.detector.name,
            accuracy="reference",
            base_seed=config.seed,
            attack=AttackSpec(**attack.model_dump(exclude={"alpha", "lambda_", "placement", "transfer_scenes"})),
            placement=PlacementSpec(**placement, sector_centre_rad=centre, sector_half_width_rad=half_width),
        )
        assets = AssetsSpec(
            scenes=chosen.model_dump(mode="json"),
            vehicles=config.vehicle.model_dump(mode="json", exclude={"name"}),
            detectors={config.detector.name: config.detector.own_weights},
            modules=config.detector.modules_by_name(),
            layouts=detector_layouts(config.detector),
        )
        groups.append(SceneGroup(chosen.kind, assets, spec))
    return groups


def _measure(config: FrontierSweepConfig, plan: FrontierPlan, folder: Path, again: bool) -> None:
    from shift3d.accuracy_time.drive import measure_frontier
    from shift3d.accuracy_time.rows import frontier_rows
    from shift3d.accuracy_time.timing import machine
    from shift3d.analysis.html.frontier import write_frontier_report
    from shift3d.store.frontier_table import frontier_table
    from shift3d.store.tables import write_table

    groups = groups_of(config)
    cases = len(plan.cases) * len(groups)
    expected_s = plan.expected_seconds(len(groups))
    what = f"{counted(len(plan.settings), 'setting')} on {counted(cases, 'case')}"
    print(f"{what}, about {round(expected_s / 60)} min on an idle core without bfloat16")
    print(f"writing to {folder}", flush=True)
    # The bar counts expected seconds: one measurement takes a second to minutes.
    shown = "{percentage:3.0f} %|{bar}| {elapsed}<{remaining}{postfix}"
    with progress_bar(slow_s=30.0, total=expected_s, bar_format=shown, smoothing=0.0) as bar:

        def tell(name: str, seconds: float, known: bool) -> None:
            """Show the current measurement and add its expected seconds; known measurements do not count as speed."""
            bar.set_postfix_str(name, refresh=sys.stderr.isatty() and not known)
            if known:
                bar.initial += seconds
            bar.update(min(seconds, max(0.0, bar.total - bar.n)))

        measured = measure_frontier(groups, plan, folder, again, tell)
    if undecided := sum(case.undecided for case in measured):
        print(f"warning: the reference could not decide {undecided} beams: their hits are unknown", file=sys.stderr)
    rows = frontier_rows(plan.settings, measured)
    write_table(folder / "frontier.parquet", frontier_table(rows, machine()))
    print(f"\n{write_frontier_report(folder)}\n\n{folder / 'report.html'}, frontier.parquet, frontier.png, advice.txt")


COMMAND = Command(
    "frontier",
    "measure accuracy against run time",
    __doc__,
    _run,
    words="overrides, kitti=PATH, and out=DIR (output folder)",
    complete=key_words(("kitti",), more=overrides),
    options=_options,
    resumes=True,
)
