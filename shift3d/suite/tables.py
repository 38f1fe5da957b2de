"""Arrow schemas of a suite, of its releases and of a gate's result, and how they are written and read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from shift3d.errors import InputError
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.tables import check_table

__all__ = ["SUITE_SCHEMAS", "SUITE_VERSION", "read_suite_table", "suite_table", "suite_table_bytes"]

SUITE_VERSION = 1
"""Of the suite's files. A suite of another version is refused."""

_OBJECT = [
    ("object_id", pa.string()),  # 128-bit BLAKE2b of what is scored
    ("role", pa.string()),  # hard, or control: the unchanged vehicle of the same task
]
_FROM = [(name, pa.string()) for name in ("task_id", "method", "vehicle", "scene", "dataset", "mode")]
_XYZ = [(name, pa.float32()) for name in "xyz"]


def _schema(name: str, fields: list[tuple[str, pa.DataType]], nullable: set[str] | None = None) -> pa.Schema:
    metadata = {"shift3d.schema": f"suite_{name}", "shift3d.schema_version": str(SUITE_VERSION)}
    return pa.schema([pa.field(n, kind, nullable=n in (nullable or ())) for n, kind in fields], metadata=metadata)


SUITE_SCHEMAS: dict[str, pa.Schema] = {
    # A row an object. The scene as detectors see it: the background's points, those of ``rows`` replaced by the first
    # of ``points`` (x, y, z after one another), the rest of these appended. hits: rows on the object. Box: scene frame,
    # geometric centre.
    "objects": _schema(
        "objects",
        [
            *_OBJECT,
            ("control", pa.string()),  # object_id of a hard object's control
            *_FROM,
            ("replicate", pa.int32()),
            ("background", pa.string()),  # of the scene's points, see "background"
            ("scene_hash", pa.string()),
            ("frames", pa.int32()),  # which of the manifest's scene sets, where frames are referenced
            ("effects", pa.list_(pa.string())),
            ("ground_z_m", pa.float64()),
            *((name, pa.float64()) for name in ("x_m", "y_m", "z_m", "dx_m", "dy_m", "dz_m", "heading_rad")),
            ("pitch_rad", pa.float64()),
            ("roll_rad", pa.float64()),
            ("radius_m", pa.float64()),  # how near a box lies that detects it
            ("precision", pa.string()),  # of the detector that scores
            ("object_points", pa.int32()),
            ("latent_code", pa.list_(pa.float32())),
            ("rows", pa.list_(pa.int32())),
            ("points", pa.list_(pa.float32())),
            ("hits", pa.list_(pa.int32())),
        ],
        {"control"},
    ),
    "background": _schema("background", _XYZ),
    # Of the sweep, and of a release.
    "scores": _schema(
        "scores",
        [("object_id", pa.string()), ("detector", pa.string()), ("weights", pa.string()), ("score", pa.float64())],
    ),
    # One background's objects scored by the weights of the gate.
    "answers": _schema("answers", [("object_id", pa.string()), ("score", pa.float64())]),
    # A gate's result, worst first.
    "gate": _schema(
        "gate",
        [
            *_OBJECT,
            *_FROM,
            ("range_m", pa.float64()),
            ("object_points", pa.int32()),
            ("score_before", pa.float64()),
            ("score", pa.float64()),
            ("change", pa.float64()),
            ("detected_before", pa.bool_()),
            ("detected", pa.bool_()),
        ],
    ),
}


def suite_table(name: str, rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows of plain values as a table of a suite's schema."""
    schema = SUITE_SCHEMAS[name]
    return pa.Table.from_pylist([dict(row) for row in rows], schema=schema)


def suite_table_bytes(table: pa.Table) -> bytes:
    """The Parquet file of a table: coordinates with their bytes apart, which compresses them to two thirds."""
    sink = pa.BufferOutputStream()
    floats = [field.name for field in table.schema if pa.types.is_float32(field.type)]
    split = dict.fromkeys(floats, "BYTE_STREAM_SPLIT")
    if "points" in table.column_names:
        split["points.list.element"] = "BYTE_STREAM_SPLIT"
    options: dict[str, Any] = {"compression": "zstd", "compression_level": 9, "write_page_checksum": True}
    if split:
        # Coordinates repeat too seldom for a dictionary.
        options |= {"column_encoding": split, "use_dictionary": False}
    pq.write_table(table.combine_chunks(), sink, **options)
    content: bytes = sink.getvalue().to_pybytes()
    return content


def read_suite_table(path: LocationLike, name: str, content: bytes | None = None) -> pa.Table:
    """Read one of the files. content: its bytes, where the caller has them.

    Raises:
        InputError: the file is missing, torn, or of another schema or version.
    """
    remedy = "Restore it from a copy, or freeze the suite again"
    try:
        source = pa.BufferReader(as_location(path).read_bytes() if content is None else content)
        table = pq.read_table(source, partitioning=None, page_checksum_verification=True)
        table = table.select(table.column_names)  # a damaged name may be no text
    except FileNotFoundError as error:
        raise InputError("is missing", str(path), remedy) from error
    except (OSError, pa.ArrowException, ValueError, KeyError) as error:
        raise InputError(f"cannot be read as Parquet ({type(error).__name__})", str(path), remedy) from error
    metadata, schema = table.schema.metadata or {}, SUITE_SCHEMAS[name]
    found = {key: metadata.get(key, b"none") for key in (b"shift3d.schema", b"shift3d.schema_version")}
    if any(found[key] != schema.metadata[key] for key in found):
        kind, version = (value.decode(errors="replace")[:40] for value in found.values())
        what = f"is {kind}, version {version}; this program reads suite_{name}, version {SUITE_VERSION}"
        raise InputError(what, str(path), "Use the version of shift3d that wrote it, or freeze the suite again")
    check_table(table, schema, path)
    return table
