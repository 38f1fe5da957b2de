"""``shift3d train``: train the shipped weights, or weights for the user's scenes and vehicles."""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from shift3d.cli.command import Command, choice, key_values, refuse, whole_number, writable_folder
from shift3d.cli.completion import key_words
from shift3d.cli.mesh_arguments import FRAME_KEYS, FRAME_TEXT, FRAME_VALUES, mesh_frame
from shift3d.cli.scene_arguments import FRAME_SETS, FRAMES_HELP, frames_config, refuse_other_keys
from shift3d.detectors.names import DETECTOR_NAMES
from shift3d.errors import InputError
from shift3d.wording import counted

if TYPE_CHECKING:
    from pathlib import Path

    from shift3d.scenes.sets import SceneSet
    from shift3d.training.command import TrainOptions

_DESCRIPTION = """\
Trains the shape model (model=sdf) or a detector (model=pointpillars, centerpoint, sst_small, sst). model= alone runs
the recipe of the shipped weights, on procedural data only, and replaces the weights in shift3d/weights. With other
vehicles (model=sdf vehicles=PATH), scenes, steps, recipe or start, everything goes to out= and no shipped file
changes. The same command resumes; Ctrl-C and SIGTERM stop the training after a checkpoint.

Seeds are fixed: on a CPU, the same command with the same processor and threads= gives the same bytes, interrupted or
not. A JSON file beside the weights holds recipe, scenes, seconds, device, versions and curve. Curves go to MLflow (make
ui); if MLflow does not answer, the training continues."""

_EPILOG = f"""\
examples:
  shift3d train model=sdf                          9,000 steps, 40 minutes on two idle cores with bfloat16
  shift3d train model=pointpillars                 1,500 steps of 8 crops, from CenterPoint's backbone: 54 minutes on
                                                   two cores with bfloat16
  shift3d train model=centerpoint                  5,500 steps of 16 crops, from PointPillars' backbone: about 14
                                                   minutes on an H200 with 16 cores, 12 hours on one core
  shift3d train model=sst                          16,000 steps, grown from the weights of sst_small
  shift3d train model=sst_small                    14,000 steps, 3 hours on one core with bfloat16
  shift3d train model=sst device=cuda              the same on a GPU; all CPU cores but one make crops
  shift3d train model=pointpillars scenes=street count=20 inserted=0 steps=300 out=DIR    a quick try
  shift3d train model=pointpillars scenes=kitti root=PATH start_from=shipped steps=500 out=DIR
                                                   adapt the shipped weights to real frames with inserted vehicles,
                                                   at a fifth of the learning rate
  shift3d train model=pointpillars scenes=openpcdet root=PATH split=train start_from=shipped out=DIR
                                                   the same on your own frames (docs/guides/scenes.md)
  shift3d train model=pointpillars start_from=random steps=20000 out=DIR
                                                   from random weights; the recipe's 1,500 steps are too few for them
  shift3d train model=pointpillars start_from=FILE steps=0 out=DIR
                                                   batch statistics and heads only (60 steps; recipe.settle_steps=N)
  shift3d train model=pointpillars start_from=shipped recipe.pasted=0 recipe.scale=0.9,1.1 out=DIR
                                                   change any field of the recipe; an unknown field lists them all
  shift3d train model=pointpillars finetune=OUT out=DIR
                                                   fine-tune on the objects that a sweep found: one epoch at a small
                                                   rate, see shift3d finetune
  shift3d train model=sdf vehicles=PATH length_m=4.5 out=DIR
                                                   a decoder for your own meshes and their codes, into DIR
  shift3d train model=sdf vehicles=wide out=DIR
                                                   a decoder for the wide family; its codes are computed from the
                                                   generator's parameters

detectors: the vehicles in training are meshes of the wide family's seen kinds, each a different one. The decoder makes
none of them; the held-out kinds are for attacks and evaluation (docs/why/family.md). In the later steps half of the
crops hold two to four more vehicles, cast into the scene on free ground (inserted=0: none). If only part of a frame is
labelled (KITTI: the camera's view), training uses only that part.
mixed precision: bfloat16 on CUDA and on processors that multiply it; elsewhere float32. mlflow=none writes no curves.

{FRAME_TEXT}"""

_FIELD = "recipe."
_OF_SCENES = {"street": (), **FRAME_SETS}
_SET_KEYS = ("scenes", *FRAME_SETS["openpcdet"], "count", "inserted")
_SCENE_KEYS = (*_SET_KEYS, "start_from")
_TUNE_KEYS = ("finetune", "method")
_KEYS = ("model", "out", "threads", "device", "mlflow", "steps", *_SCENE_KEYS, *_TUNE_KEYS, "vehicles", *FRAME_KEYS)
_VALUES = {
    "method": ("adversarial", "baseline"),
    "model": ("sdf", *DETECTOR_NAMES),
    "device": ("auto", "cpu", "cuda"),
    "scenes": tuple(_OF_SCENES),
    "start_from": ("shipped", "random"),
    "mlflow": ("none",),
    **FRAME_VALUES,
}
_STORE, _EXPERIMENT = "sqlite:///mlflow.db", "shift3d-training"


def _run(arguments: argparse.Namespace) -> int:
    fields = [word for word in arguments.words if word.startswith(_FIELD)]
    values = key_values([word for word in arguments.words if word not in fields], _KEYS, ("model",), "train")
    if "vehicles" in values:
        named = {word.partition("=")[0]: "" for word in fields}
        refuse(named, named, "is for detectors", "train")
        return _train_on_meshes(values)
    if "method" in values and "finetune" not in values:
        raise InputError("method= says which objects of finetune=", where="train", remedy="Give finetune=OUT too")
    refuse(values, FRAME_KEYS, "is for meshes, and vehicles=PATH is not given", "train")
    if values["model"] == "sdf":
        refuse(values, (*_SCENE_KEYS, *_TUNE_KEYS), "is for detectors", "train")
    if "finetune" in values:
        refuse(values, _SET_KEYS, "means nothing with finetune=, whose sweep has the scenes", "train")
    model, options = values["model"], _options(values, _recipe_words(fields))
    with _curves(values, model, options) as report:
        began = time.monotonic()
        if "finetune" in values:
            weights = _fine_tune(values, options, report)
        else:
            from shift3d.training.command import train

            weights = train(model, options, report)
    print(f"{model}: done after {(time.monotonic() - began) / 60:.1f} min, weights and their JSON: {weights}")
    return 0


def _fine_tune(values: dict[str, str], options: TrainOptions, report: Any) -> Path:
    """Fine-tune a detector on a sweep's objects. All output goes to out=."""
    if values["model"] not in DETECTOR_NAMES:
        raise InputError(f"finetune= is for detectors, not model={values['model']}", "train", "Give model=pointpillars")
    from shift3d.finetuning.tune import fine_tune

    return fine_tune(values["model"], values["finetune"], options, values.get("method", "adversarial"), report)


def _number(values: dict[str, str], key: str) -> int | None:
    return whole_number(values, key, 2, "train") if key in values else None


def _recipe_words(words: list[str]) -> dict[str, str]:
    """Parse words recipe.FIELD=VALUE to field: value."""
    names = [word.partition("=")[0] for word in words]
    found = key_values(words, names, (), "train")
    return {name.removeprefix(_FIELD): value for name, value in found.items()}


def _options(values: dict[str, str], recipe: dict[str, str] | None = None) -> TrainOptions:
    from shift3d.training.command import RANDOM, TrainOptions

    scenes = _frames(values)
    tail = "-finetuned" if "finetune" in values else "" if scenes is None else f"-{scenes.dataset}"
    folder = f"outputs/train-{values['model']}{tail}"
    # steps=0 with existing weights trains the heads only.
    heads_alone = values.get("steps") == "0" and values.get("start_from", RANDOM) != RANDOM
    return TrainOptions(
        out=writable_folder(values.get("out", folder)),
        threads=_number(values, "threads"),
        device=values.get("device", "auto"),
        scenes=scenes,
        count=_number(values, "count"),
        steps=0 if heads_alone else _number(values, "steps"),
        inserted=0 if values.get("inserted") == "0" else _number(values, "inserted"),
        start_from=values.get("start_from"),
        recipe=recipe or {},
    )


def _frames(values: dict[str, str]) -> SceneSet | None:
    """Return the labelled frames to train on; None for the recipe's own streets."""
    kind = choice(values, "scenes", _VALUES["scenes"], "train")
    refuse_other_keys(values, kind, _OF_SCENES, "train")
    if kind == "street":
        return None
    from shift3d.settings.schema.scenes import scene_set

    return scene_set(frames_config(values, kind, _number(values, "count"), "train"))


@contextmanager
def _curves(values: dict[str, str], model: str, options: TrainOptions) -> Iterator[Callable[[Any], None] | None]:
    """Yield the function that reports training curves to an MLflow run; None with mlflow=none."""
    uri = values.get("mlflow", _STORE)
    if uri == "none":
        yield None
        return
    from shift3d.analysis.mlflow.store_uri import check_store

    check_store(uri, "mlflow")
    from dataclasses import asdict

    from shift3d.analysis.mlflow.training import TrainingCurves
    from shift3d.training.command import MODELS, detector_recipe

    words = {key: value for key, value in values.items() if key not in ("mlflow", "threads", "out")}
    words |= {f"{_FIELD}{name}": value for name, value in options.recipe.items()}
    params: dict[str, Any] = {"command": words, "out": str(options.out)}
    if "finetune" in values:
        pass  # the recipe depends on the number of objects; the JSON file beside the weights holds it
    elif model in MODELS and model != "sdf":
        params["recipe"] = asdict(detector_recipe(model, options))
    elif "vehicles" not in values and model == "sdf":
        from shift3d.training.sdf.train import SdfRecipe

        params["recipe"] = asdict(SdfRecipe())
    # One run per folder and command, so that the same command continues its run.
    key = f"{options.out.resolve()} {sorted(words.items())}"
    curves = TrainingCurves(uri, _EXPERIMENT, f"train-{model}", key.replace("'", ""), params)
    yield curves
    curves.finish()


def _train_on_meshes(values: dict[str, str]) -> int:
    """Train the shape model on meshes. All output goes to out=; the shipped weights do not change."""
    if values["model"] != "sdf":
        what = f"vehicles= is for model=sdf, not model={values['model']}"
        raise InputError(what, where="train", remedy="Give model=sdf")
    wide = values["vehicles"] == "wide"
    of_detectors = [key for key in (*_SCENE_KEYS, *_TUNE_KEYS) if not (wide and key == "count")]
    refuse(values, of_detectors, "is for detectors", "train")
    built = "is for mesh files; the wide family is built in metres (a folder of that name: vehicles=./wide)"
    refuse(values, FRAME_KEYS if wide else (), built, "train")
    frame = None if wide else mesh_frame(values, "train")
    options = _options({**values, "out": values.get("out", "outputs/train-vehicles")})
    with _curves(values, "sdf", options) as report:
        if frame is None:
            from shift3d.training.sdf.parametric import train_wide_family

            chamfer_cm = train_wide_family(options.out, options.compute(), options.count, options.steps, report)
        else:
            from shift3d.training.sdf.on_meshes import STEPS, train_on_meshes

            steps = options.steps or STEPS
            chamfer_cm = train_on_meshes(values["vehicles"], frame, options.out, options.compute(), steps, report)
    print(
        f"{counted(len(chamfer_cm), 'vehicle')}, decoder and codes in {options.out}/; symmetric Chamfer distance "
        f"to the meshes: median {statistics.median(chamfer_cm):.2f} cm, worst {max(chamfer_cm):.2f} cm"
    )
    return 0


COMMAND = Command(
    "train",
    "train the shipped weights or your own",
    f"{_DESCRIPTION}\n\n{_EPILOG}",
    _run,
    words=f"model=sdf|{'|'.join(DETECTOR_NAMES)} [out=DIR] [steps=N] [device=auto|cpu|cuda] [threads=N] "
    "[mlflow=URI|none]; "
    f"detectors: [scenes={'|'.join(_OF_SCENES)}] {FRAMES_HELP} [split=NAME] [count=N] [inserted=N] "
    "[start_from=FILE|shipped|random] "
    "[recipe.FIELD=VALUE] [finetune=OUT [method=adversarial|baseline]]; "
    f"sdf: vehicles=PATH|wide [count=N] [{'=] ['.join(FRAME_KEYS)}=]",
    complete=key_words(_KEYS, _VALUES),
    resumes=True,
)
