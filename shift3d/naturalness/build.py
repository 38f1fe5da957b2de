"""A reference set from its source: built once, calibrated, and kept in the user's cache folder."""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np
from tqdm import tqdm

from shift3d.errors import InputError
from shift3d.naturalness.calibration import FEWEST, Calibration
from shift3d.naturalness.reference import Member, ReferenceSet, left_out_cm, read_reference, write_reference
from shift3d.naturalness.sizes import published_ranges
from shift3d.naturalness.sources import Build, ReferenceSource, source_hash
from shift3d.naturalness.surface import surface_of_mesh
from shift3d.store.user_cache import program_digest, user_cache
from shift3d.wording import counted

CALIBRATED = 400
"""Members that are left out, one after the other, for the calibration: of more, these, spread over all."""
_PROCESSES, _LEAST_FOR_PROCESSES = 2, 150
_CODE = ("naturalness", "sdf", "vehicles", "seeding.py")
"""What makes members: a set that other code made is made again."""


def load_reference(source: ReferenceSource, where: str) -> ReferenceSet:
    """A reference set from the cache, built and kept there when it is new or cannot be read.

    where: the setting or the folder, for errors.
    Raises: InputError as `build_reference`.
    """
    path = reference_file(source)
    with _alone(path.with_suffix(".lock")):
        if path.is_file():
            with contextlib.suppress(InputError):
                return read_reference(path)
        members, calibration = build_reference(source, where)
        try:
            write_reference(path, members, calibration)
        except (OSError, InputError):  # a cache that cannot be written is done without
            return _in_memory(members, calibration)
        return read_reference(path)


@contextlib.contextmanager
def _alone(lock: Path) -> Iterator[None]:
    """While this lasts, other processes of the machine wait: of many workers one builds, and the others read."""
    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError):
            lock.parent.mkdir(parents=True, exist_ok=True)
            fcntl.flock(held.enter_context(lock.open("w")), fcntl.LOCK_EX)
        yield


def reference_file(source: ReferenceSource) -> Path:
    """Where a reference set is kept: its name changes with its source, and with the code and the libraries that make
    it."""
    digest = hashlib.blake2b((source_hash(source) + program_digest(*_CODE)).encode(), digest_size=16)
    return user_cache() / "reference" / f"{digest.hexdigest()}.safetensors"


def build_reference(source: ReferenceSource, where: str) -> tuple[list[Member], Calibration]:
    """Build every member of a set and calibrate it; two processes and a progress bar where that takes long.

    Raises: InputError: a member that cannot be read; no members, or fewer than a calibration needs; members of sizes
    that no vehicle has, as another unit gives them.
    """
    builds = source.members()
    if len(builds) < FEWEST:
        what = f"{counted(len(builds), 'member')}, and a percentile of members left out needs {FEWEST}"
        raise InputError(what, where, remedy=f"Give {FEWEST} vehicles or more")
    members = list(tqdm(_built(builds), total=len(builds), desc="building the reference set", mininterval=2.0))
    _check_sizes(members, where)
    return members, _calibration(members)


def _built(builds: Sequence[Build]) -> Iterator[Member]:
    if len(builds) < _LEAST_FOR_PROCESSES:
        yield from map(_member, builds)
        return
    # Not forked: the caller may hold threads, and locks with them.
    with ProcessPoolExecutor(_PROCESSES, multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(_member, builds, chunksize=16)


def _member(build: Build) -> Member:
    name, mesh = build()
    return Member.of(name, surface_of_mesh(mesh))


def _check_sizes(members: Sequence[Member], where: str) -> None:
    """Refuse a set of another unit or orientation: half of it or more has sizes that no vehicle has."""
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
    chosen = np.unique(np.linspace(0, len(members) - 1, min(CALIBRATED, len(members))).round().astype(int))
    reference = _in_memory(members, None)
    with ThreadPoolExecutor(_PROCESSES) as pool:  # most of the time is spent in searches that let other threads run
        work = pool.map(functools.partial(left_out_cm, reference), chosen.tolist())
        found = np.array(list(tqdm(work, total=len(chosen), desc="calibrating it", mininterval=2.0)))
    return Calibration(*np.ascontiguousarray(found.T))


def _in_memory(members: Sequence[Member], calibration: Calibration | None) -> ReferenceSet:
    names, fingerprints = [member.name for member in members], np.stack([member.fingerprint for member in members])
    return ReferenceSet(names, fingerprints, lambda number: members[number].surface(), calibration)
