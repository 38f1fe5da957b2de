"""Commands ``shift3d train`` and ``shift3d evaluate model=sdf``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shift3d.detectors.names import DETECTOR_NAMES
from shift3d.errors import InputError
from shift3d.processor import usable_cpus
from shift3d.store.atomic import check_writable

if TYPE_CHECKING:
    from shift3d.scenes.sets import SceneSet
    from shift3d.training.compute import Compute
    from shift3d.training.detector.recipe import Recipe
    from shift3d.training.progress import Report

MODELS = ("sdf", *DETECTOR_NAMES)
ADAPTING_SHARE = 0.2
RANDOM = "random"
WEIGHTS_FOLDER = Path(__file__).resolve().parents[1] / "weights"


@dataclass(frozen=True)
class TrainOptions:
    """Options of `shift3d train` beside the model.

    out: folder for samples, scenes and checkpoints. threads: None for every core. device: auto, cpu or cuda. scenes:
    labelled scenes; None for the recipe's own streets. count: number of these streets. steps, inserted (number of
    scenes with inserted vehicles): None for the recipe's. start_from: a weights file, "shipped", or "random" for random
    weights even if the recipe names a start. recipe: fields as text.
    """

    out: Path
    threads: int | None = None
    device: str = "auto"
    scenes: SceneSet | None = None
    count: int | None = None
    steps: int | None = None
    inserted: int | None = None
    start_from: str | None = None
    recipe: Mapping[str, str] = field(default_factory=dict)

    @property
    def shipped(self) -> bool:
        """True if recipe and scenes are those of the shipped weights, which no other training overwrites."""
        own = (self.count, self.steps, self.inserted, self.start_from)
        return self.scenes is None and not self.recipe and all(value is None for value in own)

    def compute(self) -> Compute:
        """Return device and threads. Raises: InputError for a device that this machine does not have."""
        from shift3d.training.compute import choose_compute

        return choose_compute(self.device, self.threads or usable_cpus())


def train(model: str, options: TrainOptions, report: Report | None = None) -> Path:
    """Train a model, or resume an interrupted training. Returns the path of the finished weights.

    The recipe of the shipped weights, which needs nothing but this package, writes to ``shift3d/weights``. Every other
    training, and so every training on real frames, writes to ``options.out``.

    Args:
        model: one of MODELS. Detectors train on meshes of the wide family's seen kinds; the decoder makes none of them.
        report: called with the curves' points after every checkpoint.

    Raises InputError: unknown model; an option that the model does not take; a checkpoint of another recipe in ``out``.
    """
    if model not in MODELS:
        raise InputError(f"unknown model {model!r}", "model=", f"Choose from {', '.join(MODELS)}")
    if options.shipped:  # will replace the installed weights: check write access first
        check_writable(WEIGHTS_FOLDER, "steps=N out=DIR")
    if model == "sdf":
        if not options.shipped:
            remedy = "Leave out scenes=, count=, steps=, inserted=, start_from= and recipe., or give vehicles=PATH"
            raise InputError("sdf is trained on vehicles, not on scenes", "train", remedy)
        return _train_sdf(options, report)
    return _train_detector(model, options, report)


def detector_recipe(name: str, options: TrainOptions) -> Recipe:
    """Build the recipe of a detector from the options.

    The options replace steps, scene numbers and fields. A start from given weights takes a fifth of the peak rate.
    Raises: InputError for an unknown field, or a value that a recipe cannot have.
    """
    from shift3d.training.detector.recipes import RECIPES, changed, scaled_to_steps

    recipe = RECIPES[name]
    if options.steps is not None:
        recipe = scaled_to_steps(recipe, options.steps)
    if options.scenes is None and options.count is not None:
        recipe = replace(recipe, mesh_scenes=options.count, inserted_scenes=min(recipe.inserted_scenes, options.count))
    if options.start_from == RANDOM:
        recipe = replace(recipe, grown_from="", backbone_from="")
    elif options.start_from is not None:
        # The peak rate that suits random weights would undo the given start (our choice).
        recipe = replace(recipe, peak_rate=ADAPTING_SHARE * recipe.peak_rate)
    if options.inserted is not None:
        recipe = replace(recipe, inserted_scenes=options.inserted)
    return changed(recipe, options.recipe)


def evaluate(model: str) -> int:
    """Print the Chamfer distance of the shipped shape model to vehicles of its training and to unseen vehicles.

    For detectors see :func:`shift3d.analysis.detector_evaluation.evaluate_detector`.

    Raises InputError: another model, or missing weights.
    """
    if model != "sdf":
        remedy = f"Give model=sdf, or detector={model} scenes=street" if model in MODELS else "Give model=sdf"
        raise InputError(f"model={model} is no shape model", "evaluate", remedy)
    from shift3d.sdf.decoder import load_decoder
    from shift3d.vehicles.fidelity import training_chamfer_m, unseen_chamfer_m

    decoder = load_decoder()
    for name, measure in (("training vehicles", training_chamfer_m), ("unseen, auto-decoded", unseen_chamfer_m)):
        metres = measure(decoder, 27)  # three of each body type
        print(
            f"sdf, {name}: Chamfer distance (mean of both directions), median {100 * np.median(metres):.2f} cm, "
            f"worst {100 * metres.max():.2f} cm, {len(metres)} vehicles",
            flush=True,
        )
    return 0


def _train_sdf(options: TrainOptions, report: Report | None) -> Path:
    from shift3d.training.compute import restore_subnormals
    from shift3d.training.sdf.export import export_sdf
    from shift3d.training.sdf.train import train_sdf

    compute = options.compute()
    with restore_subnormals():
        checkpoint = train_sdf(options.out, compute=compute, report=report)
        export_sdf(checkpoint, WEIGHTS_FOLDER)
    return WEIGHTS_FOLDER / "sdf.safetensors"


def _train_detector(name: str, options: TrainOptions, report: Report | None) -> Path:
    from shift3d.training.detector.train import train_detector

    weights = (WEIGHTS_FOLDER if options.shipped else options.out) / f"{name}.safetensors"
    start_from = None
    if options.start_from not in (None, RANDOM):
        shipped = WEIGHTS_FOLDER / f"{name}.safetensors"
        start_from = shipped if options.start_from == "shipped" else Path(str(options.start_from)).expanduser()
    train_detector(
        options.out,
        detector_recipe(name, options),
        weights_file=weights,
        scenes=options.scenes,
        start_from=start_from,
        compute=options.compute(),
        report=report,
    )
    return weights
