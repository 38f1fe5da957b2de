"""Arrow schemas of everything a sweep writes (design section 5), with their version in the metadata."""

from __future__ import annotations

import pyarrow as pa

__all__ = ["AGGREGATES", "SCHEMAS", "SCHEMA_VERSION", "SEGMENTS", "SPEC_COLUMNS", "schema_of"]

SCHEMA_VERSION = 5

# Columns that the spec of a task determines: filled in by the sweep, the same in every table that has them.
_SPEC_FIELDS = [
    ("task_id", pa.string()),
    ("sweep", pa.string()),
    ("vehicle", pa.string()),
    ("scene", pa.string()),
    ("dataset", pa.string()),
    ("mode", pa.string()),
    ("lambda", pa.float64()),
    ("alpha", pa.float64()),
    ("detector", pa.string()),
    ("accuracy", pa.string()),
]
SPEC_COLUMNS = tuple(name for name, _ in _SPEC_FIELDS)
_NULLABLE = {"lambda"}

_POSE = [(name, pa.float64()) for name in ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad")]


def _schema(name: str, fields: list[tuple[str, pa.DataType]], nullable: set[str]) -> pa.Schema:
    metadata = {"shift3d.schema": name, "shift3d.schema_version": str(SCHEMA_VERSION)}
    return pa.schema([pa.field(n, kind, nullable=n in nullable) for n, kind in fields], metadata=metadata)


_SCORES = _schema(
    "scores",
    [
        *_SPEC_FIELDS[:9],
        ("scored_by", pa.string()),
        ("method", pa.string()),
        ("replicate", pa.int32()),
        ("score", pa.float64()),
        ("adversarial_loss", pa.float64()),
        ("latent_distance", pa.float64()),
        *_POSE,
        ("range_m", pa.float64()),
        ("object_points", pa.int32()),
        ("overlap_ok", pa.bool_()),
        ("contact_ok", pa.bool_()),
        ("best_step", pa.int32()),
        ("accuracy", pa.string()),
        ("effects", pa.list_(pa.string())),
        ("score_reference", pa.float64()),
        ("stable", pa.bool_()),
        ("status", pa.string()),
        ("max_residual_m", pa.float64()),
        ("unresolved_beams", pa.int32()),
        # Smallest |e . grad g| of the object's hits, and the share of the gradient that grazing beams carry: at the
        # start of the search for the baseline, the mean over its steps for what it found.
        ("least_slope", pa.float64()),
        ("grazing_gradient", pa.float64()),
        # NaN and infinities met on the way to this row (points, proposals, losses, gradients): 0 by construction.
        ("non_finite", pa.int32()),
        # What the accuracy preset's error came to on some of the row's own beams, see task/audit.py.
        ("audited_beams", pa.int32()),
        ("audited_hits", pa.int32()),
        ("missed_hits", pa.int32()),
        ("false_hits", pa.int32()),
        ("wrong_surface", pa.int32()),
        ("depth_error_max_m", pa.float64()),
    ],
    # Null where nothing could be placed (status says so), where the verification at reference accuracy has not been
    # run, where a method is not audited, and where no gradient was taken at the object (random, noise).
    nullable={
        *_NULLABLE, "score", "adversarial_loss", "latent_distance", *(n for n, _ in _POSE), "range_m",
        "object_points", "overlap_ok", "contact_ok", "best_step", "score_reference", "stable",
        "max_residual_m", "unresolved_beams", "least_slope", "grazing_gradient", "non_finite",
        "audited_beams", "audited_hits", "missed_hits", "false_hits", "wrong_surface", "depth_error_max_m",
    },
)  # fmt: skip

_SOLUTIONS = _schema(
    "solutions",
    [
        *_SPEC_FIELDS,
        ("effects", pa.list_(pa.string())),
        ("method", pa.string()),
        ("replicate", pa.int32()),
        ("latent_code", pa.list_(pa.float32())),
        *_POSE,
    ],
    nullable=_NULLABLE,
)

_TIMINGS = _schema(
    "timings",
    [
        ("task_id", pa.string()),
        ("method", pa.string()),
        ("stage", pa.string()),
        ("milliseconds", pa.float64()),
        ("calls", pa.int64()),
    ],
    nullable=set(),
)

# A solution that was scored again, see task/verify.py: one row a solution and detector.
_VERIFICATION = _schema(
    "verification",
    [
        *_SPEC_FIELDS[:9],
        ("scored_by", pa.string()),
        ("method", pa.string()),
        ("replicate", pa.int32()),
        ("accuracy", pa.string()),
        ("score", pa.float64()),  # as the sweep reported it
        ("score_again", pa.float64()),  # at the sweep's accuracy: the same, bit for bit, on the same machine
        ("score_reference", pa.float64()),
        ("margin", pa.float64()),  # baseline's score minus this one
        ("margin_reference", pa.float64()),
        # Every beam of the sweep's rendering against the reference's.
        ("hits_reference", pa.int32()),
        ("missed_hits", pa.int32()),
        ("false_hits", pa.int32()),
        ("wrong_surface", pa.int32()),
        ("depth_error_max_m", pa.float64()),
        ("unresolved_beams", pa.int32()),
        ("unresolved_reference", pa.int32()),
        # Scores under range noise, and a little off the pose: the mean, and the least margin to the baseline's.
        ("score_noise", pa.float64()),
        ("least_margin_noise", pa.float64()),
        ("score_nearby", pa.float64()),
        ("least_margin_nearby", pa.float64()),
        ("stable", pa.bool_()),
        ("robust", pa.bool_()),
        ("cause", pa.string()),
    ],
    nullable={*_NULLABLE, "cause"},
)

_ATTEMPTS = _schema(
    "attempts",
    [
        ("task_id", pa.string()),
        ("attempt", pa.int32()),
        ("outcome", pa.string()),  # done | failed | crashed
        ("error", pa.string()),
        ("traceback", pa.string()),
        ("quarantined", pa.bool_()),
        ("worker", pa.string()),
        ("started_unix_s", pa.float64()),
        ("seconds", pa.float64()),
    ],
    nullable={"error", "traceback"},
)

# One group of tasks that a curve, an AUC or a grid is taken over.
GROUP_FIELDS = [
    ("sweep", pa.string()),
    ("dataset", pa.string()),
    ("vehicle", pa.string()),
    ("mode", pa.string()),
    ("lambda", pa.float64()),
    ("alpha", pa.float64()),
    ("detector", pa.string()),
    ("accuracy", pa.string()),
    ("effects", pa.string()),  # as asked for: auto, none, or names joined by +; what ran is in the scores
    ("scored_by", pa.string()),
    ("method", pa.string()),
]
GROUP_COLUMNS = tuple(name for name, _ in GROUP_FIELDS)

_CURVES = _schema(
    "curves",
    [*GROUP_FIELDS, ("score_threshold", pa.float64()), ("recall", pa.float64())],
    nullable=_NULLABLE,
)

_AUC = _schema(
    "auc",
    [
        *GROUP_FIELDS,
        ("auc", pa.float64()),
        ("scores", pa.int64()),  # rows that the mean was taken over
        ("tasks_scored", pa.int64()),
        ("tasks_planned", pa.int64()),
        ("mean_adversarial_loss", pa.float64()),
        ("mean_latent_distance", pa.float64()),
        ("selected", pa.bool_()),  # by the paper's rule for lambda, per vehicle
    ],
    nullable={*_NULLABLE, "auc", "mean_adversarial_loss", "mean_latent_distance"},
)

_BEV = _schema(
    "bev",
    [
        *GROUP_FIELDS,
        ("cell_x_m", pa.float64()),  # lower corner of the cell, scene frame
        ("cell_y_m", pa.float64()),
        ("cell_size_m", pa.float64()),
        ("scores", pa.int64()),
        ("mean_score_baseline", pa.float64()),
        ("mean_score", pa.float64()),
        ("mean_reduction", pa.float64()),
    ],
    nullable=_NULLABLE,
)

# Written by commits, task by task.
SEGMENTS = ("scores", "solutions", "timings", "verification", "attempts")
# Computed from the scores when a sweep has finished.
AGGREGATES = ("curves", "auc", "bev")
SCHEMAS: dict[str, pa.Schema] = {
    "scores": _SCORES,
    "solutions": _SOLUTIONS,
    "timings": _TIMINGS,
    "verification": _VERIFICATION,
    "attempts": _ATTEMPTS,
    "curves": _CURVES,
    "auc": _AUC,
    "bev": _BEV,
}


def schema_of(name: str) -> pa.Schema:
    """Schema of one table by name."""
    return SCHEMAS[name]
