"""File plan.parquet: one row per task; values that tasks share are stored once.

The spec of a task is its ``template`` and its ``task_scene``, two JSON texts that many tasks share and that the file
stores once each; the other columns serve readers with pandas, polars or duckdb. Reading the file computes the ids again
from both texts.

Source: our choice.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from shift3d.errors import InputError
from shift3d.store.schemas import SCHEMA_VERSION
from shift3d.store.tables import parquet_bytes, parquet_table
from shift3d.sweep.planning.task_ids import read_task_scene, read_template, task_ids, template_json
from shift3d.sweep.planning.tasks import PlannedTask, Tasks
from shift3d.sweep.planning.tasks_builder import tasks_of
from shift3d.task.spec import TaskSpec, is_current

_SHARED = pa.dictionary(pa.int32(), pa.string())
_SCHEMA = pa.schema(
    [
        ("position", pa.int64()),
        ("task_id", pa.string()),
        ("vehicle", _SHARED),
        ("scene", _SHARED),
        ("dataset", _SHARED),
        ("mode", _SHARED),
        ("lambda", pa.float64()),
        ("alpha", pa.float64()),
        ("detector", _SHARED),
        ("accuracy", _SHARED),
        ("search", _SHARED),
        ("effects", pa.list_(pa.string())),
        ("effects_requested", pa.list_(pa.string())),
        ("assets", pa.int32()),
        ("template", _SHARED),
        ("task_scene", _SHARED),
    ],
    metadata={"shift3d.schema": "plan", "shift3d.schema_version": str(SCHEMA_VERSION)},
)
_READ = ["task_id", "effects_requested", "assets", "template", "task_scene"]
# Column names of older files.
_FORMER = {"ground": "template", "place": "task_scene", "effects_asked": "effects_requested"}
_ROW_GROUP = 2**20
# Each row group stores shared texts once; beyond this many bytes Parquet would repeat them.
_DICTIONARY_BYTES = 2**30
_DAMAGE = (OSError, pa.ArrowException, KeyError, ValueError, TypeError, AttributeError, IndexError, RecursionError)


def plan_bytes(tasks: Tasks) -> bytes:
    """Return tasks as a Parquet file; equal tasks give equal bytes."""
    columns = _columns(tasks)
    return parquet_bytes(
        pa.Table.from_arrays([columns[name] for name in _SCHEMA.names], schema=_SCHEMA),
        row_group_size=_ROW_GROUP,
        use_dictionary=[name for name in _SCHEMA.names if _SCHEMA.field(name).type == _SHARED],
        dictionary_pagesize_limit=_DICTIONARY_BYTES,
    )


def _columns(tasks: Tasks) -> dict[str, pa.Array]:
    used, template = np.unique(tasks.template, return_inverse=True)
    templates = [tasks.templates[number] for number in used]
    found, task_scene = np.unique(tasks.task_scene, return_inverse=True)
    task_scenes = tasks.task_scenes.take(pa.array(found))

    def shared(value: Callable[[TaskSpec], str]) -> pa.Array:
        return _shared([value(spec) for spec in templates], template)

    lambdas = np.array([np.nan if spec.lambda_ is None else spec.lambda_ for spec in templates])[template]
    return {
        "position": pa.array(np.arange(len(tasks))),
        "task_id": tasks.ids,
        "vehicle": shared(lambda spec: spec.vehicle),
        "scene": _shared([read_task_scene(text)[0] for text in task_scenes.to_pylist()], task_scene),
        "dataset": shared(lambda spec: spec.dataset),
        "mode": shared(lambda spec: spec.mode),
        "lambda": pa.array(lambdas, mask=np.isnan(lambdas)),
        "alpha": pa.array(np.array([spec.alpha for spec in templates], dtype=np.float64)[template]),
        "detector": shared(lambda spec: spec.detector),
        "accuracy": shared(lambda spec: spec.accuracy),
        "search": shared(lambda spec: spec.search),
        "effects": _lists([spec.effects for spec in templates], template),
        "effects_requested": _lists(tasks.requested_values, tasks.requested),
        "assets": pa.array(tasks.assets),
        "template": shared(template_json),
        "task_scene": pa.DictionaryArray.from_arrays(pa.array(task_scene.astype(np.int32)), task_scenes),
    }


def _shared(values: Sequence[str], which: np.ndarray) -> pa.Array:
    """Return the text at each index of ``which`` into values; equal texts are stored once."""
    return pa.array(values, type=pa.string()).dictionary_encode().take(pa.array(which))


def _lists(values: Sequence[tuple[str, ...]], which: np.ndarray) -> pa.Array:
    return pa.array([list(value) for value in values], type=pa.list_(pa.string())).take(pa.array(which))


def read_tasks(content: bytes, where: str) -> Tasks:
    """Return the tasks of :func:`plan_bytes`; also reads files of older programs, which hold every spec in full.

    where: the file's path, for the error.
    Raises: InputError: the file is no plan, damaged, or holds an id that is not its task's.
    """
    try:
        source = pa.BufferReader(content)
        names = pq.read_schema(source).names
        if "spec" in names:
            return _whole_specs(parquet_table(source, ["task_id", "spec", "assets", "effects_asked"]))
        former = "ground" in names
        columns = [name for name in names if _FORMER.get(name, name) in _READ]
        table = parquet_table(source, columns)
        return _tasks(table.rename_columns([_FORMER.get(name, name) for name in table.column_names]), former)
    except _DAMAGE as error:
        raise InputError(f"cannot be read ({error})", where=where, remedy="Restore it from a copy") from error


def stored_effect_requests(content: bytes, tasks: Tasks) -> tuple[str, ...]:
    """Return the effect settings of a stored plan of the same tasks; () if equal to those of `tasks` or unreadable."""
    try:
        source = pa.BufferReader(content)
        name = next(name for name in pq.read_schema(source).names if _FORMER.get(name, name) == "effects_requested")
        column = parquet_table(source, [name])[name]
        found = pc.binary_join(column.cast(pa.list_(pa.string())), "\n").combine_chunks()
    except (*_DAMAGE, StopIteration):
        return ()
    if found.equals(pc.binary_join(_lists(tasks.requested_values, tasks.requested), "\n")):
        return ()
    return tuple(dict.fromkeys(label for text in pc.unique(found).to_pylist() for label in (text or "").split("\n")))


def _whole_specs(table: pa.Table) -> Tasks:
    assets = table["assets"].to_pylist()
    if not all(type(index) is int for index in assets):
        raise ValueError("an index of assets is missing")
    specs = (TaskSpec.from_dict(json.loads(text)) for text in table["spec"].to_pylist())
    requested = (tuple(names) for names in table["effects_asked"].to_pylist())
    tasks = tasks_of(map(PlannedTask, specs, assets, requested))
    return replace(tasks, ids=_one_chunk(table["task_id"].cast(pa.string())))


def _tasks(table: pa.Table, former: bool) -> Tasks:
    """Convert a table to tasks. Ids are checked unless they were computed from an older spec version, or from older
    column names (former)."""
    for name in _READ:
        if table[name].null_count:
            raise ValueError(f"{name} is missing in {table[name].null_count} rows")
    templates, template = _numbered(table["template"])
    task_scenes, task_scene = _numbered(table["task_scene"])
    # Labels contain no line feed, so the joined text can be split again.
    labels, requested = _numbered(pc.binary_join(table["effects_requested"], "\n"))
    specs = tuple(read_template(text) for text in templates.to_pylist())
    former |= not all(is_current(json.loads(text)) for text in templates.to_pylist())
    ids = _one_chunk(table["task_id"].cast(pa.string()))
    found = [read_task_scene(text) for text in task_scenes.to_pylist()]
    if not former and not ids.equals(task_ids(specs, found, template, task_scene)):
        raise ValueError("an id is not its task's")
    return Tasks(
        templates=specs,
        task_scenes=task_scenes,
        template=template,
        task_scene=task_scene,
        assets=table["assets"].cast(pa.int32()).to_numpy(),
        requested=requested,
        requested_values=tuple(tuple(text.split("\n")) if text else () for text in labels.to_pylist()),
        ids=ids,
    )


def _numbered(column: pa.ChunkedArray) -> tuple[pa.Array, np.ndarray]:
    """Return the distinct texts of a column, and the index of each row's text."""
    if not pa.types.is_dictionary(column.type):
        column = pc.dictionary_encode(column)
    encoded = _one_chunk(column.unify_dictionaries())
    numbers = encoded.indices.cast(pa.int32()).to_numpy(zero_copy_only=False)
    return encoded.dictionary.cast(pa.string()), numbers


def _one_chunk(column: pa.ChunkedArray) -> pa.Array:
    return column.combine_chunks() if column.num_chunks != 1 else column.chunk(0)
