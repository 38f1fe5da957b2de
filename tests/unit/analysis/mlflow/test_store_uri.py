"""A store that MLflow cannot use is reported before a sweep, not after it."""

from __future__ import annotations

from pathlib import Path

import pytest

from shift3d.analysis.mlflow.store_uri import _SCHEMES, check_store
from shift3d.cli.main import main
from shift3d.errors import InputError


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("text")


def test_the_schemes_are_those_of_mlflow() -> None:
    from mlflow.tracking._tracking_service.utils import _tracking_store_registry as registry

    assert set(_SCHEMES) <= set(registry._registry) <= {*_SCHEMES, "", "file-plugin"}


@pytest.mark.parametrize(
    "uri",
    [
        "sqlite:///mlflow.db",
        "sqlite:///below/mlflow.db",
        "sqlite://",
        "http://127.0.0.1:9",
        "mlruns",
        "file:///tmp/m",
        "mysql+pymysql://host/name",
        "databricks",
        "databricks://profile",
    ],
)
def test_a_store_that_may_be(uri: str, tmp_path: Path) -> None:
    check_store(uri)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("uri", "why"),
    [
        ("foo://bar", "tracking.uri foo://bar: unknown scheme 'foo'. One of: sqlite, http"),
        ("htpp://host", "Did you mean"),
        ("sqlite:///file/mlflow.db", "part of this path is a file"),
        ("sqlite:////proc/mlflow.db", "nothing can be written here"),
        ("file/runs", "part of this path is a file"),
        ("file:///proc/runs", "nothing can be written here"),
    ],
)
def test_a_store_that_cannot_be(uri: str, why: str) -> None:
    with pytest.raises(InputError, match=why) as refused:
        check_store(uri)
    assert "out=DIR" not in str(refused.value), "another word names it"


@pytest.mark.parametrize(
    "command",
    [
        ["sweep", "smoke", "scenes.count=1", "tracking.uri=foo://bar"],
        ["sweep", "smoke", "scenes.count=1", "tracking.uri=foo://bar", "--dry-run"],
        ["sweep", "smoke", "tracking.uri="],
        ["train", "model=pointpillars", "count=1", "steps=2", "mlflow=foo://bar", "out=here"],
        ["frontier", "--quick", "tracking.uri=foo://bar"],
        ["ui", "--uri", "foo://bar"],
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_every_command_says_it_first(command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(command) == 2
    captured = capsys.readouterr()
    assert len(captured.err.strip().splitlines()) == 1 and not captured.out
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
