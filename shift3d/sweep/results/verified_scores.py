"""What a sweep's verification says, put into its table of scores."""

from __future__ import annotations

import pyarrow as pa

from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.tables import read_table

FOLDER = "verification"
"""Where a verification lies in its sweep's folder: a sweep's folder itself, with a log and final tables."""
_KEY = ["task_id", "scored_by", "method", "replicate"]
_TAKEN = ("score_reference", "stable")


def read_verification(folder: LocationLike) -> pa.Table | None:
    """The finished verification of the sweep in ``folder``; None where there is none.

    Raises: InputError: it is damaged, or of another version.
    """
    path = as_location(folder) / FOLDER / "final" / "verification.parquet"
    return read_table(path, "verification") if path.is_file() else None


def with_verification(scores: pa.Table, verification: pa.Table) -> pa.Table:
    """The scores with ``score_reference`` and ``stable`` of every row that was verified; order and the rest as is."""
    known = {tuple(row[name] for name in _KEY): row for row in verification.select([*_KEY, *_TAKEN]).to_pylist()}
    keys = zip(*(scores[name].to_pylist() for name in _KEY), strict=True)
    found = [known.get(key, {}) for key in keys]
    for name in _TAKEN:
        place, field = scores.schema.get_field_index(name), scores.schema.field(name)
        scores = scores.set_column(place, field, pa.array([row.get(name) for row in found], type=field.type))
    return scores
