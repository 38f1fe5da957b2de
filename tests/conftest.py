"""Settings of all tests: one thread, fixed seeds, and the folder of real data if it exists."""

from __future__ import annotations

import copy
import gc
import io
import os
import secrets
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from shift3d.errors import InputError
from shift3d.processor import configure_runtime

# As in a worker, before torch is imported. One thread: tests run in parallel, and a task's bytes are defined on one
# thread.
configure_runtime(1)

# Every Ray of a test session uses one token, and nothing is written to the user's home.
os.environ.setdefault("RAY_AUTH_MODE", "token")
os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))

# Drawn examples are the same in every run, so that a failure repeats. --hypothesis-profile=default draws others.
settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")

REPOSITORY = Path(__file__).resolve().parents[1]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start the tests that take minutes first, so that no process is left with one at the end."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[Any]:
    """Exclude modules and tests from garbage collection: they live for the whole session. Collect more rarely."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()
        gc.set_threshold(20_000)


@pytest.fixture(scope="session", autouse=True)
def compositions() -> Iterator[None]:
    """Compose the same words over the same files once per session, and parse the same YAML once."""
    from omegaconf import OmegaConf

    from shift3d.settings import compose

    fresh, read = compose._composed, OmegaConf.load
    known: dict[Any, Any] = {}

    def stamps(*folders: Path) -> tuple[tuple[str, int, int, int], ...]:
        files = {path: path.stat() for folder in folders for path in folder.rglob("*.yaml")}
        return tuple((str(path), at.st_mtime_ns, at.st_size, at.st_ino) for path, at in sorted(files.items()))

    def remembered(sweep: Path, search: str, overrides: Sequence[str]) -> Any:
        folders = [folder.absolute() for folder in (*compose.places("conf"), *compose.places("sweeps"), sweep.parent)]
        files = stamps(*(folder for folder in folders if folder.is_dir()))
        key = (str(sweep.absolute()), search, files, tuple(overrides))
        if key not in known:
            known[key] = fresh(sweep, search, overrides)  # refused words are not cached
        return copy.deepcopy(known[key])

    def parsed(file: Any) -> Any:
        if not hasattr(file, "read"):
            return read(file)
        text = file.read()
        if text not in known:
            known[text] = read(io.StringIO(text))
        return copy.deepcopy(known[text])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compose, "_composed", remembered)
        patch.setattr(OmegaConf, "load", staticmethod(parsed))
        yield


@pytest.fixture(autouse=True)
def subnormal_numbers() -> None:
    """Restore subnormal numbers, which a training loop flushes to zero for good: hypothesis needs them near zero."""
    if torch := sys.modules.get("torch"):
        torch.set_flush_denormal(False)


@pytest.fixture
def real_data() -> Callable[[str], Path]:
    """``real_data("kitti")`` is that folder of real data beside the repository; a test skips if it does not exist."""

    def find(name: str) -> Path:
        root = Path(os.environ.get("SHIFT3D_REAL_DATA", REPOSITORY.parent / "shared" / "real"))
        if not (root / name).is_dir():
            pytest.skip(f"no real data: {root.name}/{name} is absent (SHIFT3D_REAL_DATA names its folder)")
        return root / name

    return find


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--assertions-only",
        action="store_true",
        help="a test fails by an assertion or an InputError alone; a crash is no finding (for tests/mutants.py)",
    )


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[pytest.TestReport]:
    report = yield
    named = (AssertionError, InputError, pytest.fail.Exception)
    if item.config.getoption("--assertions-only") and report.failed:
        assert call.excinfo is not None
        if call.when != "call" or not call.excinfo.errisinstance(named):
            report.outcome, report.longrepr = "skipped", (str(item.path), 0, f"crashed: {call.excinfo.typename}")
    return report
