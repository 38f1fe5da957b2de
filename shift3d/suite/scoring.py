"""Scoring of a suite's objects with a detector, background by background; results are kept in one file each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import pandas as pd
import torch

from shift3d.detectors.base import Detector
from shift3d.detectors.loading import detector_of
from shift3d.errors import InputError
from shift3d.processes import each
from shift3d.settings.catalogue.detector_files import detector_hash
from shift3d.store.location import Location
from shift3d.suite.frozen import FrozenSuite, box_of
from shift3d.suite.tables import read_suite_table, suite_table, suite_table_bytes
from shift3d.task.scoring import score_box


@dataclass
class Scorer:
    """Detector by name. weights: a file, None for the shipped ones. module: Python file of the user's own detector.
    layout: of a detector of another codebase, see `detectors.foreign.layout`.

    Raises: InputError, when weights or scores are requested, for files that are missing or do not fit.
    """

    name: str
    weights: str | None = None
    module: str | None = None
    layout: Mapping[str, Any] | None = None
    _opened: dict[str, Detector] = field(default_factory=dict)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for another process, without opened detectors."""
        return {**vars(self), "_opened": {}}

    @property
    def digest(self) -> str:
        """128-bit BLAKE2b of the detector's files, hex."""
        return detector_hash(self.name, self.weights, self.module, self.layout)

    def at(self, precision: str) -> Detector:
        """Return the detector with its arithmetic in a precision."""
        if precision not in self._opened:
            made_of = self.weights, self.module, precision, self.layout
            self._opened[precision] = detector_of(self.name, *made_of)  # type: ignore[arg-type]
        return self._opened[precision]


def score_suite(suite: FrozenSuite, scorer: Scorer, folder: Location, workers: int = 1) -> Iterator[pd.DataFrame]:
    """Score every object; yield a table of object_id and score for each background, in the suite's order.

    Results in ``folder`` are reused and new results are stored there, so that a killed run resumes. The bytes are the
    same for any number of workers: each is a process on one thread.

    Args:
        folder: for results of this suite and this detector only. workers: number of processes.
    Raises: InputError: a scene or a file of results that is missing or damaged, or the disk is full.
    """
    names = list(dict.fromkeys(suite.objects["background"]))
    files = {name: folder / f"{name}.parquet" for name in names}
    for torn in folder.leftovers():
        torn.delete()
    present = set(folder.names())
    missing = [name for name in names if files[name].name not in present]
    coming = each(_answers, missing, workers, partial(tuple, (suite, scorer)))
    for name in names:
        if name in missing:
            files[name].write_atomic(suite_table_bytes(suite_table("answers", next(coming))))
        yield read_suite_table(
            files[name], "answers", remedy="Remove the file: the next run scores its objects again"
        ).to_pandas()


def _answers(opened: tuple[FrozenSuite, Scorer], name: str) -> list[dict[str, str | float]]:
    (suite, scorer), background = opened, opened[0].background(name)
    found: list[dict[str, str | float]] = []
    for row in suite.objects[suite.objects["background"] == name].to_dict("records"):
        points, detectors = suite.points_of(row, background), {scorer.name: scorer.at(row["precision"])}
        place = torch.from_numpy(points), box_of(row), row["ground_z_m"], row["radius_m"]
        try:
            found.append({"object_id": row["object_id"], "score": score_box(*place, detectors)[scorer.name].score})
        except InputError as error:  # of a user's detector
            what = f"{error.what}, at object {row['object_id'][:12]} in scene {row['scene']}"
            raise InputError(what, error.where, error.remedy) from error
    return found
