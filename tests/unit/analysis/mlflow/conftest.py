"""A separate MLflow store per test, copied from an empty one made once: MLflow takes seconds to create its tables."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

FILE = "mlflow.db"


@pytest.fixture(scope="session")
def _empty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from mlflow import MlflowClient

    file = tmp_path_factory.mktemp("mlflow") / FILE
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(file.parent)
        assert len(MlflowClient(f"sqlite:///{file}").search_experiments()) == 1
    return file


@pytest.fixture
def uri(_empty: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Address of a store in the test's folder, the working directory: artifacts of a sqlite store go to ./mlruns."""
    monkeypatch.chdir(tmp_path)
    return f"sqlite:///{shutil.copy(_empty, tmp_path / FILE)}"
