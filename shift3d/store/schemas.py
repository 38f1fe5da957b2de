"""Arrow schemas of everything a sweep writes (design section 5), with their version in the metadata."""

from __future__ import annotations

import pyarrow as pa

__all__ = ["AGGREGATES", "FOLLOW_UPS", "SCHEMAS", "SCHEMA_VERSION", "SEGMENTS", "SPEC_COLUMNS", "schema_of"]

# A new one needs a step in store/migrations.py and a folder of the former one in tests/reference.
SCHEMA_VERSION = 10

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
    ("search", pa.string()),  # how the search went and where it might go, see task.spec.AttackSpec.label
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
        ("search", pa.string()),
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
        # How natural the row's shape is, see naturalness/: distance to the nearest member of the reference set, mean of
        # both directions and the larger 95th percentile; share of left-out members that lie nearer, per cent; within
        # the 95th and of a vehicle's sizes.
        ("surface_distance_cm", pa.float64()),
        ("surface_distance_p95_cm", pa.float64()),
        ("naturalness_percentile", pa.float64()),
        ("natural", pa.bool_()),
    ],
    # Null where nothing could be placed (status says so), where the verification at reference accuracy has not been
    # run, where a method is not audited, where no gradient was taken at the object (random, noise), and where
    # naturalness was not measured (noise, naturalness=none, programs before version 9) or there is no surface.
    nullable={
        *_NULLABLE, "score", "adversarial_loss", "latent_distance", *(n for n, _ in _POSE), "range_m",
        "object_points", "overlap_ok", "contact_ok", "best_step", "score_reference", "stable",
        "max_residual_m", "unresolved_beams", "least_slope", "grazing_gradient", "non_finite",
        "audited_beams", "audited_hits", "missed_hits", "false_hits", "wrong_surface", "depth_error_max_m",
        "surface_distance_cm", "surface_distance_p95_cm", "naturalness_percentile", "natural",
    },
)  # fmt: skip

_SOLUTIONS = _schema(
    "solutions",
    [
        *_SPEC_FIELDS,
        ("effects", pa.list_(pa.string())),
        ("method", pa.string()),
        ("replicate", pa.int32()),
        ("drawn_as", pa.string()),
        ("latent_code", pa.list_(pa.float32())),
        *_POSE,
    ],
    nullable={*_NULLABLE, "drawn_as"},  # null: as the task's own vehicle
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
        ("search", pa.string()),
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

# One row a step of a search, step 0 its start: the numbers that the search has anyway.
_TRAJECTORIES = _schema(
    "trajectories",
    [
        *_SPEC_FIELDS,
        ("step", pa.int32()),
        ("kept", pa.bool_()),  # the step that the solution is
        # Of the best box near the object before suppression, at the search's own precision: what the search sees.
        ("proposal_score", pa.float64()),
        ("loss", pa.float64()),
        ("adversarial_loss", pa.float64()),  # the rest of the loss is lambda times the squared latent distance
        ("latent_distance", pa.float64()),
        *_POSE,
        ("object_points", pa.int32()),
        ("valid", pa.bool_()),  # all realism constraints hold
    ],
    # Null where a search that diverged met a number that is not finite.
    nullable={*_NULLABLE, "proposal_score", "loss", "adversarial_loss", "latent_distance"},
)

# A shape that was found, put into another scene at a random place and heading, and its baseline at the same one.
_TRANSFERS = _schema(
    "transfers",
    [
        *_SPEC_FIELDS,
        ("scored_by", pa.string()),
        ("other_scene", pa.string()),
        ("effects", pa.list_(pa.string())),
        ("score_baseline", pa.float64()),
        ("score", pa.float64()),
        # Of the baseline; the shape stands on the ground at the same x, y and heading, at a height of its own.
        *_POSE,
        ("z_shape_m", pa.float64()),
        ("range_m", pa.float64()),
        ("object_points_baseline", pa.int32()),
        ("object_points", pa.int32()),
        ("overlap_ok", pa.bool_()),  # of the shape
        ("contact_ok", pa.bool_()),
        ("status", pa.string()),  # ok | no_placement
    ],
    nullable={
        *_NULLABLE, "score_baseline", "score", *(n for n, _ in _POSE), "z_shape_m", "range_m", "overlap_ok",
        "object_points_baseline", "object_points", "contact_ok",
    },
)  # fmt: skip

# What a shape looks like, see naturalness/: a row a method and replicate of a shape task, and a pose task's baseline.
_SHAPES = _schema(
    "shapes",
    [
        *_SPEC_FIELDS,
        ("method", pa.string()),
        ("replicate", pa.int32()),
        ("length_m", pa.float64()),
        ("width_m", pa.float64()),
        ("height_m", pa.float64()),
        ("clearance_m", pa.float64()),
        ("asymmetry_cm", pa.float64()),  # mean distance of the surface to its mirror image
        ("largest_piece", pa.float64()),  # share of the surface
        ("nearest_member", pa.string()),
        ("to_member_cm", pa.float64()),  # from the shape's points to the member, mean
        ("to_member_p95_cm", pa.float64()),
        ("from_member_cm", pa.float64()),
        ("from_member_p95_cm", pa.float64()),
        ("out_of_range", pa.list_(pa.string())),  # sizes that no published vehicle has
    ],
    # Null for a code without a surface, and for what a program before version 9 did not measure.
    nullable={
        *_NULLABLE, "length_m", "width_m", "height_m", "clearance_m", "asymmetry_cm", "nearest_member", "to_member_cm",
        "to_member_p95_cm", "from_member_cm", "from_member_p95_cm", "out_of_range",
    },
)  # fmt: skip

# The labelled vehicles of scenes, and the shapes that were fitted to what is seen of them, see retrieval/.
_VEHICLE_POOL = _schema(
    "vehicle_pool",
    [
        ("task_id", pa.string()),
        ("scene", pa.string()),
        ("dataset", pa.string()),
        ("label", pa.int32()),  # row among the scene's labels
        ("kind", pa.string()),  # the data set's own name for it
        ("x_m", pa.float64()),  # of the label's box
        ("y_m", pa.float64()),
        ("z_m", pa.float64()),
        ("length_m", pa.float64()),
        ("width_m", pa.float64()),
        ("height_m", pa.float64()),
        ("yaw_rad", pa.float64()),
        ("range_m", pa.float64()),
        ("points", pa.int32()),
        ("sides", pa.list_(pa.string())),
        ("detector", pa.string()),
        ("score", pa.float64()),  # of the detector where it stands
        ("status", pa.string()),  # fitted | few_points | box_size
        ("flags", pa.list_(pa.string())),  # what speaks against it, see retrieval.reconstruction.FLAGS
        ("latent_code", pa.list_(pa.float32())),
        ("scale_m", pa.float64()),
        ("coordinates", pa.list_(pa.float64())),
        ("uncertainty", pa.list_(pa.float64())),
        ("residual_cm", pa.float64()),
        ("outliers", pa.float64()),
        ("shape_error_cm", pa.float64()),
        ("mean_shape_error_cm", pa.float64()),
    ],
    # Null where a vehicle could not be fitted, and where nobody knows the truth.
    nullable={
        "latent_code", "scale_m", "coordinates", "uncertainty", "residual_cm", "outliers", "shape_error_cm",
        "mean_shape_error_cm",
    },
)  # fmt: skip

# Vehicles of a pool put in the place of a solution, see task/retrieval.py.
_RETRIEVED = _schema(
    "retrieved",
    [
        *_SPEC_FIELDS,
        ("scored_by", pa.string()),
        ("role", pa.string()),  # retrieved | control
        ("replicate", pa.int32()),
        ("pool_dataset", pa.string()),
        ("pool_scene", pa.string()),
        ("pool_label", pa.int32()),
        ("pool_score", pa.float64()),  # of the attacked detector where it stands
        ("pool_range_m", pa.float64()),
        ("pool_points", pa.int32()),
        ("latent_distance", pa.float64()),  # from the solution
        ("excluded", pa.bool_()),  # by the paper's rule: the nearest lies farther than the solution's code is long
        ("score_baseline", pa.float64()),
        ("score_solution", pa.float64()),
        ("score", pa.float64()),
        ("object_points", pa.int32()),
        ("overlap_ok", pa.bool_()),
        ("contact_ok", pa.bool_()),
    ],
    nullable=_NULLABLE,
)

_MEASURES = (
    "length_cm", "width_cm", "height_cm", "clearance_cm", "nose_cm", "tail_cm", "bonnet_cm", "windshield_deg",
    "rear_window_deg", "front_overhang_cm", "wheelbase_cm", "rear_overhang_cm", "volume_m3",
)  # fmt: skip

# The meshes of solutions, measured, see vehicles/mesh_measures.py: a row a method of a shape task.
_PATTERNS = _schema(
    "patterns",
    [
        *_SPEC_FIELDS,
        ("method", pa.string()),
        ("replicate", pa.int32()),
        *((name, pa.float64()) for name in _MEASURES),
        ("pieces", pa.int32()),
    ],
    # Null where the mesh does not have it.
    nullable={*_NULLABLE, *_MEASURES, "pieces"},
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
    ("search", pa.string()),
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

_CELL_FIELDS = [
    ("cell_x_m", pa.float64()),  # lower corner of the cell, scene frame
    ("cell_y_m", pa.float64()),
    ("cell_size_m", pa.float64()),
    ("scores", pa.int64()),
    ("mean_score_baseline", pa.float64()),
    ("mean_score", pa.float64()),
    ("mean_reduction", pa.float64()),
]

_BEV = _schema(
    "bev",
    [*GROUP_FIELDS, *_CELL_FIELDS],
    nullable=_NULLABLE,
)

# The scores of `transfers` by the cell that the vehicle was put into. A cell that nothing was put into is a row without
# scores; cells are those of the square that the tasks' largest range needs.
_BEV_TRANSFER = _schema(
    "bev_transfer",
    [*GROUP_FIELDS, *_CELL_FIELDS],
    nullable={*_NULLABLE, "mean_score_baseline", "mean_score", "mean_reduction"},
)

# What there was a choice of and why one was taken, see sweep/hyperparameters.py: one row a candidate.
_CHOICES = _schema(
    "choices",
    [
        ("sweep", pa.string()),
        ("parameter", pa.string()),  # alpha | lambda
        ("mode", pa.string()),
        ("vehicle", pa.string()),  # null: for all of them
        ("alpha", pa.float64()),  # that lambda is chosen at
        ("detector", pa.string()),
        ("accuracy", pa.string()),
        ("search", pa.string()),
        ("effects", pa.string()),
        ("candidate", pa.float64()),
        ("found", pa.float64()),  # alpha: AUC of what was found; lambda: its mean adversarial loss
        ("tasks", pa.int64()),
        ("chosen", pa.bool_()),
        ("why", pa.string()),
    ],
    nullable={"vehicle", "alpha"},
)

# Written by commits, task by task. A table that a folder does not have is empty: those that came later than the first
# ones need no new version, and folders without them stay readable.
SEGMENTS = (
    "scores", "solutions", "timings", "verification", "trajectories", "transfers", "shapes", "vehicle_pool",
    "retrieved", "patterns", "attempts",
)  # fmt: skip
FOLLOW_UPS = ("verification", "vehicle_pool", "retrieved", "patterns")
"""Those that commands of their own make of a sweep that has finished."""
# Computed from the scores when a sweep has finished.
AGGREGATES = ("curves", "auc", "bev", "bev_transfer", "choices")
SCHEMAS: dict[str, pa.Schema] = {
    "scores": _SCORES,
    "solutions": _SOLUTIONS,
    "timings": _TIMINGS,
    "verification": _VERIFICATION,
    "trajectories": _TRAJECTORIES,
    "transfers": _TRANSFERS,
    "shapes": _SHAPES,
    "vehicle_pool": _VEHICLE_POOL,
    "retrieved": _RETRIEVED,
    "patterns": _PATTERNS,
    "attempts": _ATTEMPTS,
    "curves": _CURVES,
    "auc": _AUC,
    "bev": _BEV,
    "bev_transfer": _BEV_TRANSFER,
    "choices": _CHOICES,
}


def schema_of(name: str) -> pa.Schema:
    """Schema of one table by name."""
    return SCHEMAS[name]
