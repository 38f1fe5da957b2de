"""Cost of naturalness, how often its prefilter misses the nearest member, and the error of its point samples."""

from __future__ import annotations

import time

import numpy as np
import pytest
from benchmarks.results import Results

from shift3d.naturalness.build import build_reference, load_reference
from shift3d.naturalness.decoded import decoded_mesh
from shift3d.naturalness.measure import NaturalnessMeter
from shift3d.naturalness.reference import ReferenceSet
from shift3d.naturalness.sources import WideReference
from shift3d.naturalness.surface import surface_of_mesh
from shift3d.sdf.meshes import distance_to_surface
from shift3d.vehicles.sources import VehicleSet


@pytest.fixture(scope="module")
def reference(quick: bool) -> ReferenceSet:
    return load_reference(WideReference(200 if quick else 2000), "bench")


def bench_first_build(bench: Results) -> None:
    start = time.perf_counter()
    build_reference(WideReference(100), "bench")
    milliseconds = 10.0 * (time.perf_counter() - start)
    bench.add("naturalness_build_ms", milliseconds, "ms", "a member of the wide family, one process, calibrated")


def bench_prefilter(bench: Results, reference: ReferenceSet, quick: bool) -> None:
    """Measure against brute force how often the nearest member is missed, and how much farther the found member is."""
    numbers = np.linspace(0, len(reference) - 1, 20 if quick else 15).astype(int)
    costs_mm, seconds = [], [0.0, 0.0]
    for number in numbers.tolist():
        shape, found = reference.surface(number), []
        for turn, candidates in enumerate((8, len(reference))):
            start = time.perf_counter()
            found.append(reference.nearest(shape, left_out=number, candidates=candidates).mean_cm)
            seconds[turn] += time.perf_counter() - start
        costs_mm.append(10.0 * (found[0] - found[1]))
    of = f"{len(numbers)} of {len(reference)} members, each left out, against a full comparison with all"
    missed = float(np.mean(np.array(costs_mm) > 0.01))
    bench.add("naturalness_prefilter_missed", missed, "share", of, note=f"at most {max(costs_mm):.2f} mm farther")
    bench.add("naturalness_prefilter_ratio", seconds[1] / seconds[0], "times", "time of the full comparison / with it")


def bench_a_code(bench: Results, reference: ReferenceSet) -> None:
    """Time decoding and comparing the shipped vehicles and random codes about them."""
    source, measures, rng = VehicleSet(), NaturalnessMeter(reference), np.random.default_rng(0)
    decoder, whole, decoding = source.decoder(), [], []
    for name in source.names() * 2:
        vehicle = source.vehicle(name)
        code = vehicle.latent_code + rng.normal(0.0, 0.06, len(vehicle.latent_code)).astype(np.float32)
        start = time.process_time()
        decoded_mesh(vehicle, decoder, code)
        decoding.append(1e3 * (time.process_time() - start))
        start = time.process_time()
        measures.of_code(vehicle, decoder, code)
        whole.append(1e3 * (time.process_time() - start))
    note = f"decoding alone {np.median(decoding):.0f} ms"
    bench.add(
        "naturalness_ms",
        float(np.median(whole)),
        "ms",
        f"processor time of a code against {len(reference)} members",
        note=note,
    )


def bench_points_against_triangles(bench: Results) -> None:
    builds = WideReference(8).members()
    meshes = [build()[1] for build in builds]
    off = []
    for first, second in zip(meshes, meshes[1:] + meshes[:1]):
        a, b = surface_of_mesh(first), surface_of_mesh(second)
        low, high = np.asarray(second.bounds)
        second = second.copy()
        second.apply_translation(-np.array([*(low + high)[:2] / 2, low[2]]))
        off.append(1e3 * (b.distances_to(a.points).mean() - distance_to_surface(a.points, second).mean()))
    of = "mean distance of eight pairs of vehicles by points, less that to triangles; the largest of them"
    bench.add("naturalness_points_off_mm", float(np.abs(off).max()), "mm", of)
