"""Earlier scores of a suite: of the sweep's own detectors, and of every accepted release."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from shift3d.errors import InputError
from shift3d.store.location import Location
from shift3d.suite.frozen import FrozenSuite
from shift3d.suite.tables import SUITE_SCHEMAS, read_suite_table, suite_table, suite_table_bytes

if TYPE_CHECKING:
    import pandas as pd

_NAME = re.compile(r"(\d{8})\.parquet")


@dataclass(frozen=True)
class Release:
    """Scores by object_id of a detector and its weights. number: of its file; 0: the sweep's own detectors."""

    number: int
    detector: str
    weights: str
    scores: Mapping[str, float]

    @property
    def name(self) -> str:
        """Name to display."""
        return f"release {self.number}" if self.number else "the sweep's weights"


def last_release(
    suite: FrozenSuite, folder: Location, detector: str, number: int | None = None, but: str = ""
) -> Release | None:
    """Return a detector's last accepted release, or the one of a number; else the scores of the sweep's own weights.

    Returns None if the detector has never scored all of these objects, or several of its weights have. Scores that
    state a kind without a name, as the sweep's do, are the detector's if no other detector of the kind has releases.

    Args:
        detector: its kind, such as "pointpillars", or "KIND:NAME" to distinguish detectors of one kind.
        but: digest of weights whose releases are skipped.
    Raises: InputError: no release of that number and detector, or a file that is damaged or another suite's.
    """
    kind = _kind(detector)
    found = _releases(suite, folder, kind)
    alone = {release.detector for release in found} <= {kind, detector}
    wanted = {detector, kind} if alone or number else {detector}
    for release in found:
        if release.detector in wanted and (release.weights != but if number is None else release.number == number):
            return release
    if number:
        raise InputError(
            f"there is no release {number} of {detector}",
            str(folder),
            "Leave against= out to compare with the last release",
        )
    table = read_suite_table(suite.folder / "scores.parquet", "scores").to_pandas()
    own = table[table["detector"] == (kind if alone else detector)]
    # Scores of only some objects, or of several weights, are no release.
    whole = set(suite.objects["object_id"]) <= set(own["object_id"]) and own["weights"].nunique() == 1
    return _release(own, 0) if whole else None


def refuse_unknown_name(suite: FrozenSuite, folder: Location, detector: str) -> None:
    """Refuse a name without releases if other names of its kind have some: it would be compared with nothing.

    detector: see `last_release`. Raises: InputError naming the others.
    """
    kind, _, name = detector.partition(":")
    named = {release.detector for release in _releases(suite, folder, kind)} - {kind}
    if named and detector not in named:
        others = sorted(other.partition(":")[2] for other in named)
        remedy = f"Give name={others[0]} for its next release, or name={name} for another detector"
        raise InputError(f"has releases of {', '.join(others)}, but none of {name}", str(folder), remedy)


def accept_release(
    suite: FrozenSuite, folder: Location, detector: str, weights: str, scores: Mapping[str, float]
) -> int:
    """Add scores to the history as the next release. Returns its number. A repeated last release is not added again.

    detector: see `last_release`. weights: their digest.
    Raises: InputError: another gate was quicker, or the folder cannot be written to.
    """
    last = last_release(suite, folder, detector)
    if last is not None and last.number and (last.weights, last.scores) == (weights, scores):
        return last.number
    taken = [int(found[1]) for name in folder.names() if (found := _NAME.fullmatch(name))]
    number = max(taken, default=0) + 1
    rows = [{"object_id": key, "detector": detector, "weights": weights, "score": scores[key]} for key in scores]
    metadata = {**SUITE_SCHEMAS["scores"].metadata, b"shift3d.suite": suite.digest.encode()}
    content = suite_table_bytes(suite_table("scores", rows).replace_schema_metadata(metadata))
    if not (folder / f"{number:08d}.parquet").put_if_absent(content):
        raise InputError(f"release {number} was accepted by another gate", str(folder), "Run this gate again")
    return number


def _kind(detector: str) -> str:
    return detector.partition(":")[0]


def _releases(suite: FrozenSuite, folder: Location, kind: str) -> list[Release]:
    """Return the accepted releases of detectors of a kind, newest first."""
    names = sorted(filter(_NAME.fullmatch, folder.names()), reverse=True)
    found = [_read(suite, folder / name, int(name[:8])) for name in names]
    return [release for release in found if _kind(release.detector) == kind]


def _read(suite: FrozenSuite, file: Location, number: int) -> Release:
    table = read_suite_table(file, "scores")
    if table.schema.metadata.get(b"shift3d.suite") != suite.digest.encode():
        remedy = "Give releases=DIR of this suite, or the suite that the release was accepted on"
        raise InputError("was accepted on another suite", str(file), remedy)
    release = _release(table.to_pandas(), number)
    if release is None or list(release.scores) != list(suite.objects["object_id"]):
        raise InputError(
            "does not hold exactly the suite's objects", str(file), "Restore the file from a copy, or remove it"
        )
    return release


def _release(table: pd.DataFrame, number: int) -> Release | None:
    if table.empty:
        return None
    scores = dict(zip(table["object_id"], table["score"], strict=True))
    return Release(number, str(table["detector"].iloc[0]), str(table["weights"].iloc[0]), scores)
