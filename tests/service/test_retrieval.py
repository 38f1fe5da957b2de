"""Retrieval and patterns are sweeps: exactly once, resumable, to the same bytes; rerunning a sweep keeps them."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import numpy as np
import pytest

from shift3d.cli.main import main
from shift3d.naturalness.decoded import decoded_mesh
from shift3d.scenes.kitti.writing import frame_files
from shift3d.settings.catalogue.reading import read_catalogue
from shift3d.settings.compose import compose_sweep
from shift3d.store.log_entries import read_log
from shift3d.store.tables import read_table
from shift3d.sweep.planning.plan import make_plan
from shift3d.sweep.retrieval import build_pool, pool_plan
from shift3d.vehicles.sources import VehicleSet

SWEEP = ["sweep", "default", "vehicle=suv", "mode=shape", "attack.lambda=1", "scenes.count=1", "scenes.sensor=hdl64"]
SETTINGS = ["attack=short", "attack.steps=1", "attack.random_replicates=0", "attack.noise_replicates=0"]
QUIET = ["naturalness=none", "effects=none", "runner=local", "tracking=none"]
CARS = {"000000": {"suv": 12.0, "coupe": 18.0}, "000001": {"convertible": 14.0}}


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two KITTI frames: shipped vehicles as the sensor sees them, ground before them, a box of three points."""
    folder = tmp_path_factory.mktemp("kitti")
    vehicles, rng = VehicleSet(), np.random.default_rng(0)
    decoder = vehicles.decoder()
    for name, cars in CARS.items():
        ground = np.column_stack((rng.uniform(3, 8, (800, 1)), rng.uniform(-3, 3, (800, 1)), np.full(800, -1.7)))
        clouds, boxes = [ground], []
        for number, (kind, x) in enumerate(cars.items()):
            vehicle = vehicles.vehicle(kind)
            mesh = decoded_mesh(vehicle, decoder, vehicle.latent_code)
            centre = np.array([x, 2.5 if number else -2.5, -1.7 + vehicle.size_m[2] / 2])
            aims = mesh.vertices + centre + rng.normal(0.0, 0.02, mesh.vertices.shape)
            starts = np.broadcast_to(-centre, aims.shape)
            clouds.append(mesh.ray.intersects_location(starts, aims, multiple_hits=False)[0] + centre)
            boxes.append([*centre, *vehicle.size_m, 0.0])
        boxes.append([30.0, 0.0, -0.9, 4.2, 1.7, 1.5, 0.4])
        clouds.append(np.array([[30.0, 0.0, -0.9], [30.1, 0.1, -0.9], [30.0, 0.1, -0.8]]))
        points = np.concatenate(clouds).astype(np.float32)
        files = frame_files(name, points, None, -1.7, np.array(boxes), ["vehicle"] * len(boxes))
        for path, content in files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
    return folder


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep without retrieved kin."""
    folder = tmp_path_factory.mktemp("sweep") / "plain"
    assert main([*SWEEP, *SETTINGS, *QUIET, f"out={folder}"]) == 0
    return folder


@pytest.fixture(scope="module")
def out(plain: Path, root: Path) -> Path:
    """The sweep with kin retrieved from the frames and with measured meshes."""
    folder = Path(shutil.copytree(plain, plain.with_name("out")))
    assert main(retrieval(folder, root, plain.with_name("pool"))) == 0
    assert main(["patterns", str(folder), "runner=local"]) == 0
    return folder


def retrieval(out: Path, root: Path, pool: Path) -> list[str]:
    return ["retrieve", str(out), f"pool={pool}", *pool_of(root), "runner=local"]


def pool_of(root: Path) -> list[str]:
    return ["scenes=kitti", f"scenes.root={root}"]


def test_the_pool_holds_every_labelled_vehicle_and_the_shapes_that_were_put_there(out: Path) -> None:
    pool = read_table(out / "final" / "vehicle_pool.parquet", "vehicle_pool").to_pandas()
    assert pool["scene"].tolist() == ["000000"] * 3 + ["000001"] * 2
    assert pool["status"].tolist() == ["fitted", "fitted", "few_points", "fitted", "few_points"]
    vehicles, fitted = VehicleSet(), pool[pool["status"] == "fitted"]
    for row, kind in zip(fitted.to_dict("records"), [kind for cars in CARS.values() for kind in cars]):
        known = {
            name: np.linalg.norm(vehicles.vehicle(name).latent_code - row["latent_code"]) for name in vehicles.names()
        }
        assert min(known, key=known.get) == kind, (kind, known)  # type: ignore[arg-type]
        assert row["residual_cm"] < 2.0 and row["scale_m"] == pytest.approx(vehicles.vehicle(kind).scale_m, rel=0.03)


def test_what_is_retrieved_is_the_vehicle_that_the_shape_was_made_from(out: Path) -> None:
    found = read_table(out / "final" / "retrieved.parquet", "retrieved").to_pandas()
    kin = found[found["role"] == "retrieved"]
    assert kin["scored_by"].tolist() == ["pointpillars"]
    assert (kin["pool_scene"].item(), kin["pool_label"].item(), kin["excluded"].item()) == ("000000", 0, False)
    scores = read_table(out / "final" / "scores.parquet", "scores").to_pandas().set_index("method")["score"]
    assert kin["score_baseline"].item() == scores["baseline"] and kin["score_solution"].item() == scores["adversarial"]
    # One step hardly moves the shape: its kin is the baseline, and scores like it in the same place.
    assert kin["score"].item() == pytest.approx(scores["baseline"], abs=0.1)
    assert kin["object_points"].item() > 200


def test_meshes_are_measured(out: Path) -> None:
    rows = read_table(out / "final" / "patterns.parquet", "patterns").to_pandas()
    assert rows["method"].tolist() == ["baseline", "adversarial"]
    size = VehicleSet().vehicle("suv").size_m
    assert rows.loc[0, ["length_cm", "width_cm", "height_cm"]].tolist() == pytest.approx(
        [100 * s for s in size], abs=2.0
    )


def test_again_runs_nothing_and_leaves_the_same_bytes(out: Path, root: Path) -> None:
    before, pool = digests(out / "final"), out.with_name("pool")
    assert main(retrieval(out, root, pool)) == 0 and main(["patterns", str(out), "runner=local"]) == 0
    assert digests(out / "final") == before
    assert sum(len(entry.done) for entry in read_log(pool)) == 2
    assert main([*SWEEP, *SETTINGS, *QUIET, f"out={out}"]) == 0
    assert digests(out / "final") == before


def test_what_was_lost_in_part_resumes_and_two_workers_come_to_the_same_bytes(
    out: Path, plain: Path, root: Path, tmp_path: Path
) -> None:
    """Each worker takes one frame. test_verification checks that workers read a sweep's solutions."""
    copy, pool = tmp_path / "copy", tmp_path / "pool"
    shutil.copytree(plain, copy)
    made, config = make_plan(compose_sweep("retrieval", [*pool_of(root), "runner.workers=2"]), read_catalogue)
    assert build_pool(pool, pool_plan(made), config.runner).done == len(CARS)
    assert main(retrieval(copy, root, pool)) == 0
    for name in ("vehicle_pool", "retrieved"):
        ours, theirs = (folder / "final" / f"{name}.parquet" for folder in (copy, out))
        assert ours.read_bytes() == theirs.read_bytes(), name
    shutil.rmtree(pool / "final")
    (copy / "final" / "retrieved.parquet").unlink()
    assert main(retrieval(copy, root, pool)) == 0
    assert (copy / "final" / "retrieved.parquet").read_bytes() == (out / "final" / "retrieved.parquet").read_bytes()


def test_the_report_shows_both(out: Path) -> None:
    from shift3d.analysis.cases.rendered import PageCache
    from shift3d.analysis.html.sections.patterns import patterns
    from shift3d.analysis.html.sections.retrieval import retrieval
    from shift3d.analysis.results import read_sweep

    sweep = read_sweep(out)
    texts = repr(retrieval(sweep, PageCache(sweep.plan))) + repr(patterns(sweep))
    assert "natural kin" in texts and "1 of 1" in texts and "2 refused" in texts and "windshield" in texts
    assert "cannot be drawn" not in texts


def test_what_cannot_be_retrieved_is_said(
    out: Path, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(retrieval(tmp_path, root, tmp_path / "pool")) == 2
    assert "is not the output folder of a sweep" in capsys.readouterr().err
    assert main([*retrieval(out, root, tmp_path / "wide"), "vehicle=wide", "vehicle.name=sedan"]) == 2
    assert "of another decoder" in capsys.readouterr().err
    assert not (tmp_path / "wide").exists(), "known before any vehicle is fitted"
    assert main(["patterns", str(out), "attack.steps=3"]) == 2
    assert "settings of the runner alone" in capsys.readouterr().err
