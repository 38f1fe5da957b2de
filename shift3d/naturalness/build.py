"""Construction of a reference set from its source: built and calibrated once, cached in the user's cache folder."""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from tqdm import tqdm

from shift3d.errors import InputError
from shift3d.naturalness.calibration import MIN_MEMBERS, Calibration
from shift3d.naturalness.reference import (
    Member,
    ReferenceSet,
    leave_one_out_distance_cm,
    read_reference,
    write_reference,
)
from shift3d.naturalness.sizes import published_ranges
from shift3d.naturalness.sources import Build, ReferenceSource, source_hash
from shift3d.naturalness.surface import surface_of_mesh
from shift3d.processes import process_pool
from shift3d.store.user_cache import program_digest, user_cache
from shift3d.wording import counted

CALIBRATION_MEMBERS = 400
"""Number of members left out in turn for the calibration; in a larger set they are spread evenly over all members."""
_PROCESSES, _LEAST_FOR_PROCESSES = 2, 150
_CODE = ("naturalness", "sdf", "vehicles", "seeding.py")
"""Source code that determines the members: a set made by other code is rebuilt."""


def load_reference(source: ReferenceSource, where: str) -> ReferenceSet:
    """Load a reference set from the cache; a set that is missing or unreadable is built and cached.

    where: the setting or the folder, for errors.
    Raises: InputError as `build_reference`.
    """
    path = reference_file(source)
    with _build_lock(path.with_suffix(".lock")):
        if path.is_file():
            with contextlib.suppress(InputError):
                return read_reference(path)
        members, calibration = build_reference(source, where)
        try:
            write_reference(path, members, calibration)
        except (OSError, InputError):  # the cache is optional
            return _in_memory(members, calibration)
        return read_reference(path)


@contextlib.contextmanager
def _build_lock(lock: Path) -> Iterator[None]:
    """Hold a lock between processes of this machine: one worker builds the set, the others wait and read it."""
    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError):
            lock.parent.mkdir(parents=True, exist_ok=True)
            fcntl.flock(held.enter_context(lock.open("w")), fcntl.LOCK_EX)
        yield


def reference_file(source: ReferenceSource) -> Path:
    """Return a reference set's cache path, named by a digest of its source, program code and library versions."""
    digest = hashlib.blake2b((source_hash(source) + program_digest(*_CODE)).encode(), digest_size=16)
    return user_cache() / "reference" / f"{digest.hexdigest()}.safetensors"


def build_reference(source: ReferenceSource, where: str) -> tuple[list[Member], Calibration]:
    """Build every member of a set and calibrate the set; a large set gets two processes and a progress bar.

    Raises: InputError for an unreadable member, fewer members than a calibration needs, or members mostly of
    implausible sizes, as from a wrong unit.
    """
    builds = source.members()
    if len(builds) < MIN_MEMBERS:
        what = f"{counted(len(builds), 'member')}, and a percentile of members left out needs {MIN_MEMBERS}"
        raise InputError(what, where, remedy=f"Give {MIN_MEMBERS} vehicles or more")
    members = list(tqdm(_built(builds), total=len(builds), desc="building the reference set", mininterval=2.0))
    _check_sizes(members, where)
    return members, _calibration(members)


def _built(builds: Sequence[Build]) -> Iterator[Member]:
    if len(builds) < _LEAST_FOR_PROCESSES:
        yield from map(_member, builds)
        return
    with process_pool(_PROCESSES) as pool:
        yield from pool.map(_member, builds, chunksize=16)


def _member(build: Build) -> Member:
    name, mesh = build()
    return Member.of(name, surface_of_mesh(mesh))


def _check_sizes(members: Sequence[Member], where: str) -> None:
    """Refuse a set of wrong unit or orientation: more than half of its members have implausible sizes."""
    ranges = published_ranges()
    limits = np.array([ranges[name] for name in ("length_m", "width_m", "height_m")])
    sizes = np.array([member.size_m for member in members])
    inside = ((sizes >= limits[:, 0]) & (sizes <= limits[:, 1])).all(axis=1)
    if inside.mean() < 0.5:
        length, width, height = np.median(sizes, axis=0)
        what = f"{len(members) - inside.sum()} of {len(members)} members have sizes that no vehicle has: the median is"
        remedy = "Give the unit or the length of the files, and their axes; the cars of one folder all point one way"
        raise InputError(f"{what} {length:.3g} x {width:.3g} x {height:.3g} m", where, remedy)


def _calibration(members: Sequence[Member]) -> Calibration:
    chosen = np.unique(np.linspace(0, len(members) - 1, min(CALIBRATION_MEMBERS, len(members))).round().astype(int))
    reference = _in_memory(members, None)
    with ThreadPoolExecutor(_PROCESSES) as pool:  # most time goes to tree queries, which release the GIL
        work = pool.map(functools.partial(leave_one_out_distance_cm, reference), chosen.tolist())
        found = np.array(list(tqdm(work, total=len(chosen), desc="calibrating it", mininterval=2.0)))
    return Calibration(*np.ascontiguousarray(found.T))


def _in_memory(members: Sequence[Member], calibration: Calibration | None) -> ReferenceSet:
    names, fingerprints = [member.name for member in members], np.stack([member.fingerprint for member in members])
    return ReferenceSet(names, fingerprints, lambda number: members[number].surface(), calibration)
