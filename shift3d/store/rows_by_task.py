"""Rows of a final table by task: the cost per task does not grow with the number of tasks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from shift3d.store.location import LocalLocation
from shift3d.store.resolve import LocationLike, as_location
from shift3d.store.tables import read_table


class RowsByTask:
    """Table of ``final/`` in which the rows of a task are contiguous.

    The constructor looks up the row range of each task. `of` reads the row groups of a task and caches them, since
    neighbouring tasks of a plan share row groups. A remote file is fetched once.

    Raises: InputError as `read_table`; `of` raises it too.
    """

    def __init__(self, path: LocationLike, name: str) -> None:
        self._path, self._name = as_location(path), name
        self._content = None if isinstance(self._path, LocalLocation) else self._path.read_bytes()
        self._held: tuple[range, pa.Table] = range(0), read_table(path, name, self._content, self._index)

    def _index(self, source: Any) -> pa.Table:
        """Store the row ranges of tasks and row groups. Returns an empty table, for the schema check."""
        with pq.ParquetFile(source, page_checksum_verification=True) as file:
            counts = [file.metadata.row_group(group).num_rows for group in range(file.num_row_groups)]
            ids = file.read(["task_id"])["task_id"].combine_chunks().dictionary_encode()
            none: pa.Table = file.schema_arrow.empty_table()
        self._starts = np.cumsum([0, *counts])
        numbers = ids.indices.to_numpy()
        first = np.unique(numbers, return_index=True)[1]
        after = len(numbers) - np.unique(numbers[::-1], return_index=True)[1]
        self._places = dict(zip(ids.dictionary.to_pylist(), zip(first.tolist(), after.tolist()), strict=True))
        return none

    def of(self, task_id: str) -> list[dict[str, Any]]:
        """Return the rows of a task, in their order."""
        if task_id not in self._places:
            return []
        first, after = self._places[task_id]
        begin = int(np.searchsorted(self._starts, first, side="right")) - 1
        groups = range(begin, int(np.searchsorted(self._starts, after)))
        if groups != self._held[0]:
            self._held = groups, read_table(self._path, self._name, self._content, lambda s: _row_groups(s, groups))
        own = self._held[1].slice(first - int(self._starts[begin]), after - first)
        rows: list[dict[str, Any]] = own.filter(pc.equal(own["task_id"], task_id)).to_pylist()
        return rows


def _row_groups(source: Any, groups: range) -> pa.Table:
    with pq.ParquetFile(source, page_checksum_verification=True) as file:
        return file.read_row_groups(list(groups), use_threads=False)
