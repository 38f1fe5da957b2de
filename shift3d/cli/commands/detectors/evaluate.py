"""\
Runs a detector once over scenes and computes every metric from its detections: AP and APH in bird's-eye view and 3D,
by Waymo's definition (LEVEL_1, LEVEL_2, range bins) and KITTI's (40 recall positions; easy, moderate and hard if the
labels have them), at IoU 0.7 and 0.5. Prints AP, APH, recall, heading flips and box errors with 95 % intervals (scenes
resampled), then the same by range, heading, number of points and kind of vehicle. Writes a folder: metrics,
breakdown, vehicles, curves, detections, truth and timings as Parquet (docs/why/models.md explains the rows),
curves.png, spec.json.
All files but timings have the same bytes for any number of workers. The same command resumes.
A detector of your own is evaluated like any other. An AP near 0 may mean that its boxes are in another frame.

model=sdf measures the shape model instead: its distance to vehicles of its training and to unseen vehicles.

examples:
  shift3d evaluate detector=pointpillars              200 held-out streets: 22 minutes on one core
  shift3d evaluate detector=sst scenes=street count=20 workers=2
  shift3d evaluate detector=pointpillars traffic=held_out   half of the vehicles are of kinds that training never sees
  shift3d evaluate detector=pointpillars scenes=kitti root=PATH      PATH holds training/; cars in the image
  shift3d evaluate detector=pointpillars weights=FILE scenes=kitti root=PATH out=DIR
  shift3d evaluate detector=openpcdet weights=FILE.pth config=FILE.yaml scenes=kitti root=PATH
  shift3d evaluate detector=own module=FILE.py scenes=kitti root=PATH
  shift3d evaluate detector=own module=FILE.py scenes=openpcdet root=PATH     your own frames (docs/guides/scenes.md)
  shift3d evaluate detector=onnx file=FILE.onnx count=20
  shift3d evaluate model=sdf

  python -c "import pandas; print(pandas.read_parquet('outputs/evaluate/NAME/metrics.parquet'))\""""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from shift3d.cli.command import Command, choice, key_values, share, whole_number, writable_folder
from shift3d.cli.completion import key_words
from shift3d.cli.detector_arguments import DETECTOR_HELP, DETECTOR_KEYS, detector_files
from shift3d.cli.scene_arguments import FRAME_SETS, FRAMES_HELP, frames_config, refuse_other_keys
from shift3d.detectors.names import DETECTOR_NAMES, FOREIGN, ONNX, OWN

if TYPE_CHECKING:
    from shift3d.analysis.detector_evaluation import EvaluatedScenes

_OF_SCENES = {"street": ("sensor", "split", "traffic"), **FRAME_SETS}
_SCENE_KEYS = tuple(dict.fromkeys(key for keys in _OF_SCENES.values() for key in keys))
_KEYS = ("detector", "scenes", "count", *_SCENE_KEYS, *DETECTOR_KEYS, "score_threshold", "workers", "out")
_VALUES = {
    "scenes": tuple(_OF_SCENES),
    "sensor": ("mixed", "hdl64", "waymo_top"),
    "split": ("test", "val", "train"),
    "traffic": ("family", "wide", "held_out"),
    "model": ("sdf",),
    "detector": (*DETECTOR_NAMES, *FOREIGN, OWN, ONNX),
}


def _run(arguments: argparse.Namespace) -> int:
    if any(word.startswith("model=") for word in arguments.words):
        from shift3d.training.command import evaluate

        return evaluate(key_values(arguments.words, ("model",), ("model",), "evaluate")["model"])
    values = key_values(arguments.words, _KEYS, ("detector",), "evaluate")
    count = whole_number(values, "count", 200, "evaluate", most=1_000_000) if "count" in values else None
    workers = whole_number(values, "workers", 1, "evaluate")
    from shift3d.analysis.detector_evaluation import dataset_of, evaluate_detector
    from shift3d.training.detector.detect_scenes import SCORE_FLOOR

    score_threshold = share(values, "score_threshold", SCORE_FLOOR, "evaluate")

    scenes = _scenes(values, count)
    name, tail = values["detector"], f"-{count}" if count else ""
    out = writable_folder(values.get("out", f"outputs/evaluate/{name}-{dataset_of(scenes)}{tail}"))
    files = detector_files(name, values, "evaluate")
    print(evaluate_detector(name, scenes, out, *files, workers=workers, score_threshold=score_threshold))
    return 0


def _scenes(values: dict[str, str], count: int | None) -> EvaluatedScenes:
    from shift3d.settings.schema.scenes import StreetConfig

    kind = choice(values, "scenes", _VALUES["scenes"], "evaluate")
    refuse_other_keys(values, kind, _OF_SCENES, "evaluate")
    if kind == "street":
        chosen = {key: choice(values, key, _VALUES[key], "evaluate") for key in _OF_SCENES[kind]}
        return StreetConfig.model_validate({"kind": kind, "seed": 0, "count": count or 200, **chosen})
    return frames_config(values, kind, count, "evaluate")


COMMAND = Command(
    "evaluate",
    "measure detectors and the shape model",
    __doc__,
    _run,
    words=f"detector=NAME {DETECTOR_HELP} [scenes=street|kitti|openpcdet] [count=N] [sensor= split= traffic=] "
    f"{FRAMES_HELP} "
    "[score_threshold=P] [workers=N] [out=DIR]; or model=sdf",
    complete=key_words((*_KEYS, "model"), _VALUES),
    resumes=True,
)
