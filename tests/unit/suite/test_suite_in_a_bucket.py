"""A suite in a bucket is gated from there, and its releases are stored there."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from bucket_server import ENVIRONMENT, bucket_server, new_bucket
from suites_by_hand import write_detector, write_suite

from shift3d.cli.main import main
from shift3d.store.resolve import as_location


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    with bucket_server() as endpoint:
        for name, value in {**ENVIRONMENT, "AWS_ENDPOINT_URL": endpoint}.items():
            monkeypatch.setenv(name, value)
        yield f"s3://{new_bucket(endpoint)}/suite"


def test_a_gate_of_a_suite_in_a_bucket(bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_suite(tmp_path / "suite")
    for file in (tmp_path / "suite").rglob("*.*"):
        (as_location(bucket) / str(file.relative_to(tmp_path / "suite"))).write_atomic(file.read_bytes())
    for bias, code in ((-2.0, 0), (-2.6, 6), (-1.0, 0)):
        module, weights = write_detector(tmp_path, bias)
        words = [f"suite={bucket}", "detector=own", f"module={module}", f"weights={weights}"]
        assert main(["gate", *words, "accept=true", "mlflow=none"]) == code
    assert (as_location(bucket) / "releases").names() == ["00000001.parquet", "00000002.parquet"]
