"""\
Does a detector get better by training on the objects that fool it? The command attacks the detector on training streets
(sweep finetune), verifies the solutions and fine-tunes the detector on the stable objects, once per seed. It measures
the detector on held-out streets: on the same vehicles (finetune_held_out) and on other body types
(finetune_other_vehicles), both attacked before and after the tuning, and on natural streets. It writes
finetune.parquet, report.html and an MLflow run.

The command runs other commands of shift3d and prints each of them first. The same command resumes: it skips finished
steps.

examples:
  shift3d finetune size=small                  100 objects, 3 seeds: two hours on two cores
  shift3d finetune                             the paper's size, 2,000 objects: days on two cores, or runner.address=
  shift3d finetune --quick                     the same steps in a few minutes; its numbers mean nothing
  shift3d finetune size=small control=true     also tunes a control model on the unchanged vehicles of the same tasks
  shift3d finetune size=small rate=3e-6 adaptive=false    another rate: uses the objects found before, and does not
                                               attack the tuned detector
  shift3d finetune size=small detector=sst streets=20 others=camper,trailer
  shift3d finetune --steps size=small          print the commands and run none

rate=   peak learning rate                    streets= natural streets for AP (200; size=small: 50)
seeds=  seeds of the tunings (0,1,2)          others=  vehicles of finetune_other_vehicles
Other words are overrides of all three sweeps (vehicle= not of finetune_other_vehicles); held_out.KEY=VALUE is an
override of the two sweeps over held-out streets only. Before anything runs, the command refuses held-out scenes that
are also attacked for training.

  python -c "import pandas; print(pandas.read_parquet('outputs/finetuning-HASH/finetune.parquet'))\""""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from shift3d.cli.command import Command, flag, key_values, local_path, run_command, whole_number
from shift3d.cli.commands import sweep
from shift3d.cli.commands.detectors import evaluate, train
from shift3d.cli.commands.follow_ups import verify
from shift3d.cli.completion import key_words, overrides
from shift3d.cli.outcomes import mirror
from shift3d.detectors.names import DETECTOR_NAMES
from shift3d.errors import InputError
from shift3d.exit_codes import ExitCode
from shift3d.signals import received_signals

if TYPE_CHECKING:
    from shift3d.finetuning.report import TunedModel
    from shift3d.settings.schema.config import Config


_KEYS = ("out", "rate", "seeds", "streets", "others", "control", "adaptive")
_FLAGS = {"control": False, "adaptive": True}
_STREETS = {"full": 200, "small": 50}
_QUICK = ["size=small", "scenes.count=2", "attack.steps=4", "vehicle=coupe,suv"]
_QUICK_VALUES = {"others": "kei_car", "streets": "2", "seeds": "0"}
_SWEEPS = ("finetune", "finetune_held_out", "finetune_other_vehicles")
_HELD_OUT = "held_out."


@dataclass(frozen=True)
class FinetuneArguments:
    """Parsed command line. words: overrides of all three sweeps; held_out: further overrides of the held-out sweeps."""

    words: list[str]
    held_out: list[str]
    seeds: list[int]
    streets: int
    rate: str | None = None
    others: str | None = None
    control: bool = False
    adaptive: bool = True
    out: str | None = None

    def overrides_of(self, sweep: str) -> list[str]:
        """Return the overrides of one of the three sweeps. ``vehicle=`` applies to the first two only."""
        if sweep == _SWEEPS[0]:
            return self.words
        both = [*self.words, *self.held_out]
        if sweep == _SWEEPS[1]:
            return both
        others = [f"vehicle.name={self.others}"] if self.others else []
        return [word for word in both if not word.startswith(("vehicle=", "vehicle."))] + others


@dataclass(frozen=True)
class PipelineStep:
    """One command of the pipeline, with its words."""

    command: Command
    words: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        return " ".join(shlex.quote(word) for word in ["shift3d", self.command.name, *self.words])


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--quick", action="store_true", help="two streets, two vehicles, four steps, one seed")
    parser.add_argument("--steps", action="store_true", help="print the commands and run none")


def read_request(words: Sequence[str], quick: bool = False) -> FinetuneArguments:
    """Parse the words of the command line. Raises: InputError: a key without a value, or an invalid value."""
    own = [word for word in words if word.partition("=")[0] in _KEYS]
    held_out = [word.removeprefix(_HELD_OUT) for word in words if word.startswith(_HELD_OUT)]
    rest = [word for word in words if word not in own and not word.startswith(_HELD_OUT)]
    values = (_QUICK_VALUES if quick else {}) | key_values(own, _KEYS, (), "finetune")
    rest = [*(_QUICK if quick else []), *rest]
    size = "small" if "size=small" in rest else "full"
    seeds, streets = values.get("seeds", "0,1,2"), whole_number(values, "streets", _STREETS[size], "finetune")
    numbers = [int(part) if part.isdecimal() else -1 for part in seeds.split(",")]
    if min(numbers) < 0 or len(set(numbers)) < len(numbers):
        raise InputError(f"seeds={seeds!r} are no different whole numbers", "finetune", "Give seeds=0,1,2")
    on = {name: flag(values, name, default, "finetune") for name, default in _FLAGS.items()}
    rate, others, out = (values.get(name) for name in ("rate", "others", "out"))
    return FinetuneArguments(rest, held_out, numbers, streets, rate, others, **on, out=out)


def _run(arguments: argparse.Namespace) -> int:
    from shift3d.processor import configure_runtime

    configure_runtime()
    request = read_request(arguments.words, arguments.quick)
    out = local_path(request.out) if request.out else None  # checked before the scenes are read, which takes a minute
    config, spec_hash = _checked(request)
    folder = out or Path(f"outputs/finetuning-{spec_hash}")
    models = _models(folder, config.detector.name, request)
    steps = list(steps_of(folder, config, request, models))
    if arguments.steps:
        print("\n".join(map(str, steps)))
        return 0
    from shift3d.finetuning import report

    incomplete = False
    for step in steps:
        code = run_step(step)
        if code not in (ExitCode.DONE, ExitCode.INCOMPLETE):
            print("the same command resumes", file=sys.stderr)
            return code
        incomplete |= code == ExitCode.INCOMPLETE
        if step.command is train.COMMAND:  # score the objects found before fine-tuning with the tuned model
            report.score_held_out(folder, next(tuned for tuned in models if f"out={tuned.folder}" in step.words))
    print(f"\n{report.write_report(folder, config.detector.name, models, [str(step) for step in steps])}")
    mirror(config.tracking, partial(report.mirror, folder, models))
    return int(ExitCode.INCOMPLETE if incomplete else ExitCode.DONE)


def run_step(step: PipelineStep) -> int:
    """Run one command of the pipeline and return its exit code. After a stop signal the code is INTERRUPTED even if the
    command finished, so that the next command does not start."""
    print(f"\n$ {step}", flush=True)
    before = received_signals()
    code = run_command(step.command, step.words)
    return code if received_signals() == before else int(ExitCode.INTERRUPTED)


def _checked(request: FinetuneArguments) -> tuple[Config, str]:
    """Check the three sweeps; return the settings and the spec hash of the training sweep.

    Raises: InputError: held-out scenes that the training sweep attacks or the weights were tuned on, streets of a split
        that must not be trained on, several detectors, a detector without a training, or an invalid rate.
    """
    from shift3d.finetuning.objects import refuse_other_splits
    from shift3d.finetuning.tune import tuning_recipe
    from shift3d.settings.compose import compose_sweep
    from shift3d.settings.expand import expand
    from shift3d.sweep.planning.kind import shift3d_kind
    from shift3d.sweep.planning.plan import make_plan
    from shift3d.training.command import TrainOptions
    from shift3d.training.provenance import refuse_tuned_scenes, shared_scenes

    catalogue, plans, config = shift3d_kind().catalogue, [], None
    for name in _SWEEPS:
        composed = compose_sweep(name, request.overrides_of(name))
        if (detector := composed.base["detector"]["name"]) not in DETECTOR_NAMES:
            remedy = f"Give one of {', '.join(DETECTOR_NAMES)}"
            raise InputError(f"there is no training of {detector}", where=f"sweep {name}", remedy=remedy)
        if len({(c.detector.name, c.detector.own_weights) for c in expand(composed)}) > 1:
            raise InputError("several detectors are attacked", where=f"sweep {name}", remedy="Give detector= one value")
        tuning_recipe(detector, 1, TrainOptions(Path(), recipe={"peak_rate": request.rate} if request.rate else {}))
        plan, own = make_plan(composed, catalogue)
        plans.append(plan)
        config = config or own
    assert config is not None
    tuned, *held_out = (
        {(task.spec.dataset, task.spec.scene, task.spec.scene_hash) for task in plan.tasks} for plan in plans
    )
    for name, scenes in zip(_SWEEPS[1:], held_out, strict=True):
        if both := shared_scenes(tuned, scenes):
            what = f"fine-tuning and {name} share {', '.join(both[:5])}{' and others' if len(both) > 5 else ''}"
            raise InputError(what, where="finetune", remedy="Hold out others: held_out.scenes.KEY=VALUE")
        if own_weights := config.detector.own_weights:
            refuse_tuned_scenes(Path(own_weights).expanduser(), scenes)
    refuse_other_splits((task.spec for task in plans[0].tasks), f"sweep {_SWEEPS[0]}")
    return config, plans[0].spec_hash


def _models(folder: Path, detector: str, request: FinetuneArguments) -> list[TunedModel]:
    from shift3d.finetuning.report import TunedModel

    names = ["finetuned", "control"] if request.control else ["finetuned"]
    rate = f"-rate{request.rate}" if request.rate else ""
    return [
        TunedModel(name, seed, folder / f"{name}{rate}-{seed}", detector) for name in names for seed in request.seeds
    ]


def steps_of(
    folder: Path, config: Config, request: FinetuneArguments, models: Sequence[TunedModel]
) -> Iterator[PipelineStep]:
    """Yield the commands of the pipeline in order."""
    from shift3d.finetuning.report import HELD_OUT, NATURAL
    from shift3d.processor import usable_cpus
    from shift3d.settings.schema.config import MlflowConfig, RayRunnerConfig

    runner, cpus = config.runner, usable_cpus()
    # `evaluate` uses processes of this machine only, so a cluster's number of workers does not apply.
    workers = min(runner.workers_on(cpus), cpus) if isinstance(runner, RayRunnerConfig) else 1
    mlflow = config.tracking.uri if isinstance(config.tracking, MlflowConfig) else "none"
    detector, own_weights = config.detector.name, config.detector.own_weights
    attacked = folder / "attacked"

    def swept(name: str, out: Path, *more: str) -> PipelineStep:
        return PipelineStep(sweep.COMMAND, [name, *request.overrides_of(name), *more, f"out={out}"])

    def measured(out: Path, weights: str | None) -> PipelineStep:
        words = [f"detector={detector}", f"count={request.streets}", f"workers={workers}"]
        return PipelineStep(evaluate.COMMAND, [*words, *([f"weights={weights}"] if weights else []), f"out={out}"])

    yield swept(_SWEEPS[0], attacked)
    yield PipelineStep(verify.COMMAND, [str(attacked), *(word for word in request.words if word.startswith("runner"))])
    for name, place in zip(_SWEEPS[1:], HELD_OUT, strict=True):
        yield swept(name, folder / place)
    yield measured(folder / "vanilla" / NATURAL, own_weights)
    for tuned in models:
        method = "adversarial" if tuned.model == "finetuned" else "baseline"
        rate = [f"recipe.peak_rate={request.rate}"] if request.rate else []
        words = [
            f"model={detector}",
            f"finetune={attacked}",
            f"method={method}",
            f"start_from={own_weights or 'shipped'}",
        ]
        # One thread, so that the weights do not depend on the number of workers.
        words += [f"recipe.seed={tuned.seed}", *rate, "threads=1", f"mlflow={mlflow}", f"out={tuned.folder}"]
        yield PipelineStep(train.COMMAND, words)
        yield measured(tuned.folder / NATURAL, str(tuned.weights))
        for name, place in zip(_SWEEPS[1:], HELD_OUT, strict=True):
            if tuned.model == "finetuned" and request.adaptive:
                yield swept(name, tuned.folder / place, f"detector.weights={tuned.weights}")


COMMAND = Command(
    "finetune",
    "fine-tune a detector on the objects that fool it, and measure it",
    __doc__,
    _run,
    words="keys below, and overrides of the sweeps",
    complete=key_words(_KEYS, more=overrides),
    options=_options,
    resumes=True,
)
