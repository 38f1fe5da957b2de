"""Arrow schemas of a suite, of its releases and of a gate's result; functions to write and read them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa

from shift3d.errors import InputError
from shift3d.store.resolve import LocationLike
from shift3d.store.schemas import schema_of_columns
from shift3d.store.tables import check_table, parquet_bytes, read_parquet

SUITE_VERSION = 1  # of the suite's files; a suite of another version is refused

# object_id: 128-bit BLAKE2b of the scored data. role: hard, or control: the unchanged vehicle of the same task.
_OBJECT = "object_id role"
_FROM = "task_id method vehicle scene dataset mode"
_BOX = "x_m y_m z_m dx_m dy_m dz_m heading_rad pitch_rad roll_rad"
_COLUMNS = {
    # One row per object. control: object_id of a hard object's control. vehicle: the drawn one, which a search over
    # kinds chooses. background: digest of the scene's points. frames: index into the manifest's scene sets, for
    # referenced frames. The scene as detectors see it: the background with its ``rows`` replaced by the first of
    # ``points`` (x, y, z in turn), and the other ``points`` appended. hits: rows on the object. Box: scene frame,
    # geometric centre. radius_m: largest distance of a detecting box. precision: of the detector that scores.
    "objects": (
        f"{_OBJECT} control? {_FROM} replicate:int32 background scene_hash frames:int32 effects:list-of-string "
        f"ground_z_m {_BOX} radius_m precision object_points "
        "latent_code:list-of-float32 rows:list-of-int32 points:list-of-float32 hits:list-of-int32"
    ),
    "background": "x:float32 y:float32 z:float32",
    # Of the sweep, and of a release.
    "scores": "object_id detector weights score",
    # One background's objects scored by the weights of the gate.
    "answers": "object_id score",
    # A gate's result, worst first.
    "gate": f"{_OBJECT} {_FROM} range_m object_points score_before score change detected_before:bool detected:bool",
}
_FLOATS = f"{_BOX} ground_z_m radius_m range_m score score_before change".split()
_TYPES = {**dict.fromkeys(_FLOATS, "float64"), "object_points": "int32"}
SUITE_SCHEMAS: dict[str, pa.Schema] = {
    name: schema_of_columns(f"suite_{name}", SUITE_VERSION, columns, _TYPES) for name, columns in _COLUMNS.items()
}


def suite_table(name: str, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Convert rows of plain values to a table of a suite's schema."""
    return pa.Table.from_pylist([dict(row) for row in rows], schema=SUITE_SCHEMAS[name])


def suite_table_bytes(table: pa.Table) -> bytes:
    """Serialize a table as Parquet; splitting the bytes of coordinates compresses them to two thirds."""
    floats = [field.name for field in table.schema if pa.types.is_float32(field.type)]
    split = dict.fromkeys(floats, "BYTE_STREAM_SPLIT")
    if "points" in table.column_names:
        split["points.list.element"] = "BYTE_STREAM_SPLIT"
    # Coordinates rarely repeat: a dictionary would not pay.
    options: dict[str, Any] = {"column_encoding": split, "use_dictionary": False} if split else {}
    return parquet_bytes(table.combine_chunks(), compression_level=9, **options)


def read_suite_table(
    path: LocationLike,
    name: str,
    content: bytes | None = None,
    remedy: str = "Restore it from a copy, or freeze the suite again",
) -> pa.Table:
    """Read one of the files. content: its bytes, if the caller has them. remedy: advice for a damaged file.

    Raises: InputError: the file is missing, torn, or of another schema or version.
    """
    table, kind, version = read_parquet(path, remedy, content=content)
    if (kind, version) != (f"suite_{name}", str(SUITE_VERSION)):
        what = f"is {kind}, version {version}; this program reads suite_{name}, version {SUITE_VERSION}"
        raise InputError(what, str(path), "Use the version of shift3d that wrote it, or freeze the suite again")
    check_table(table, SUITE_SCHEMAS[name], path, remedy)
    return table
