"""A verification is a sweep: it resumes, repeats nothing, and survives another run of the verified sweep."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from bucket_server import ENVIRONMENT, bucket_server, new_bucket

from shift3d.cli.main import main
from shift3d.store.log_entries import read_log
from shift3d.store.resolve import as_location
from shift3d.store.tables import read_table

SWEEP = ["sweep", "default", "vehicle=suv", "mode=pose", "scenes.count=1", "scenes.sensor=hdl64", "attack=short"]
SETTINGS = ["attack.steps=1", "attack.random_replicates=0", "naturalness=none", "runner=local", "tracking=none"]
SETTINGS += ["attack.placement.min_range_m=38", "attack.placement.min_object_points=50"]  # few beams meet it


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def unverified(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep without a verification."""
    folder = tmp_path_factory.mktemp("sweep") / "finished"
    assert main([*SWEEP, *SETTINGS, f"out={folder}"]) == 0
    assert read_table(folder / "final" / "scores.parquet", "scores")["stable"].to_pylist() == [None, None]
    return folder


@pytest.fixture(scope="module")
def out(unverified: Path) -> Path:
    """The sweep, verified."""
    folder = Path(shutil.copytree(unverified, unverified.with_name("out")))
    assert main(["verify", str(folder), "runner=local"]) == 0
    return folder


def test_the_final_tables_say_what_was_verified(out: Path) -> None:
    scores = read_table(out / "final" / "scores.parquet", "scores")
    verification = read_table(out / "final" / "verification.parquet", "verification")
    assert scores["stable"].to_pylist() == [True, True]
    assert scores["score_reference"].to_pylist() == verification["score_reference"].to_pylist()
    assert "Stability of default" in (out / "final" / "stability.html").read_text()


def test_again_runs_nothing_and_leaves_the_same_bytes(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = digests(out / "final")
    assert main(["verify", str(out), "runner=local"]) == 0
    assert digests(out / "final") == before
    assert sum(len(entry.done) for entry in read_log(out / "verification")) == 1
    assert main([*SWEEP, *SETTINGS, f"out={out}"]) == 0
    assert "nothing is left to run" in capsys.readouterr().out
    assert digests(out / "final") == before


def test_a_verification_that_was_lost_in_part_resumes(out: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    shutil.rmtree(copy / "verification" / "final")
    assert main(["verify", str(copy), "runner=local"]) == 0
    assert digests(copy / "final") == digests(out / "final")


def test_in_a_bucket_it_comes_to_the_same_bytes(unverified: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sweep's log and tables are in the bucket, from which a Ray worker reads the solutions."""
    with bucket_server() as endpoint:
        for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": endpoint}.items():
            monkeypatch.setenv(name, value)
        bucket = as_location(f"s3://{new_bucket(endpoint)}/runs/sweep")
        for path in unverified.rglob("*"):
            if path.is_file():
                (bucket / path.relative_to(unverified).as_posix()).write_atomic(path.read_bytes())
        assert main(["verify", str(bucket), "runner.workers=1"]) == 0
        for name in ("scores", "solutions", "verification"):
            found = (bucket / "final" / f"{name}.parquet").read_bytes()
            assert found == (out / "final" / f"{name}.parquet").read_bytes(), name
        assert "Stability of default" in (bucket / "final" / "stability.html").read_bytes().decode()


def test_what_cannot_be_verified_is_said(out: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(tmp_path)]) == 2
    assert "is not the output folder of a sweep" in capsys.readouterr().err
    copy = tmp_path / "unfinished"
    shutil.copytree(out, copy)
    shutil.rmtree(copy / "final")
    assert main(["verify", str(copy)]) == 2
    assert "the sweep is not finished" in capsys.readouterr().err
    damaged = tmp_path / "damaged"
    shutil.copytree(out, damaged)
    for name in ("scores", "solutions"):
        (damaged / "final" / f"{name}.parquet").write_bytes(b"PAR1 torn")
        assert main(["verify", str(damaged)]) == 2
        assert f"{name}.parquet: cannot be read as Parquet" in capsys.readouterr().err
        shutil.copy(out / "final" / f"{name}.parquet", damaged / "final")
    segment = next((damaged / "data").glob("*-scores.parquet"))
    segment.write_bytes(segment.read_bytes()[:500])
    shutil.rmtree(damaged / "verification")
    command = [sys.executable, "-m", "shift3d", "verify", str(damaged)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2, "no abort at the process's end"
    assert f"{segment.name}: cannot be read as Parquet" in done.stderr.splitlines()[-1]
    assert not (damaged / "verification").exists(), "found before hours of work"
    assert main(["verify", str(out), "attack.steps=3"]) == 2
    assert "settings of the runner alone" in capsys.readouterr().err
