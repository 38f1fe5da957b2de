"""Options, fixtures and results file. `make bench` collects bench_*.py; a plain pytest collects no benchmark."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import torch
from benchmarks.results import Record, Results, comparison, read_results, summary

from shift3d.processor import has_fast_bfloat16

if TYPE_CHECKING:
    from benchmarks.steps import AttackLoops
    from benchmarks.world import World

OUTPUTS = Path(__file__).resolve().parents[2] / "outputs"
RESULTS = pytest.StashKey[Results]()
OLD = pytest.StashKey[Mapping[str, Record]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("shift3d benchmarks")
    group.addoption("--quick", action="store_true", help="few repeats, thinned beams for the paper's renderer")
    group.addoption("--against", metavar="FILE", default=None, help="results of an earlier run to compare with")
    group.addoption("--json", metavar="FILE", default=None, help="where results go (default: outputs/bench.json)")


def _target(config: pytest.Config) -> Path:
    """Return the results file. A quick run has a file of its own, because its numbers are no measurement."""
    given = config.getoption("--json")
    return Path(given) if given else OUTPUTS / ("bench-quick.json" if config.getoption("--quick") else "bench.json")


def pytest_configure(config: pytest.Config) -> None:
    # A missing file must fail before minutes of measuring, not after them.
    if against := config.getoption("--against", None):
        try:
            config.stash[OLD] = read_results(Path(against))
        except ValueError as error:
            raise pytest.UsageError(f"--against: {error}") from error


@pytest.fixture(scope="session")
def bench(pytestconfig: pytest.Config, quick: bool) -> Results:
    """Results so far; `bench.add(...)` adds a record."""
    results = Results(_printer(pytestconfig), "quick run: no measurement" if quick else "")
    threads = torch.get_num_threads()
    results.add("cores", os.cpu_count() or 1, "cores", f"{_processor()}; torch {torch.__version__}, {threads} thread")
    pytestconfig.stash[RESULTS] = results
    return results


def _printer(config: pytest.Config) -> Callable[[str], None]:
    """Return a function that writes lines to the terminal at once, past pytest's capture."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    capture = config.pluginmanager.get_plugin("capturemanager")
    if reporter is None or capture is None:
        return lambda line: None

    def show(line: str) -> None:
        with capture.global_and_fixture_disabled():
            reporter.ensure_newline()
            reporter.write_line(f"  {line}", flush=True)

    return show


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    named = [line for line in info.read_text().splitlines() if line.startswith("model name")] if info.is_file() else []
    name = named[0].partition(":")[2].strip() if named else platform.machine()
    return f"{name}, {torch.backends.cpu.get_cpu_capability()}"


@pytest.fixture(scope="session")
def quick(pytestconfig: pytest.Config) -> bool:
    """True if benchmarks run just long enough to show that everything works."""
    return bool(pytestconfig.getoption("--quick"))


@pytest.fixture(scope="session")
def world(quick: bool) -> World:
    """Scene, vehicle, decoder and detector of all measurements."""
    from benchmarks.world import open_world

    return open_world(thin=20 if quick else 1)


@pytest.fixture(scope="session")
def loops(world: World, quick: bool) -> AttackLoops:
    """Attacks in the standard preset, timed once; benchmarks may run them again."""
    from benchmarks.steps import AttackLoops

    attacks = AttackLoops(world.problem(world.counterpart_scene), steps=3 if quick else 7)
    attacks.run()
    return attacks


@pytest.fixture(scope="session")
def peak_gflops(bench: Results, quick: bool) -> dict[torch.dtype, float]:
    """Measured peaks by dtype, with their records: one measurement for all shares and limits of a run."""
    from benchmarks.arithmetic import gemm_peak_gflops

    dtypes = [torch.float32, torch.float64] + ([torch.bfloat16] if has_fast_bfloat16() else [])
    peaks = {}
    for dtype in dtypes:
        name = str(dtype).removeprefix("torch.")
        peaks[dtype], size = gemm_peak_gflops(dtype, budget_s=1.0 if quick else 4.0)
        of = f"best square matrix product in {name}, one thread"
        bench.add(f"gemm_peak_gflops_{name}", peaks[dtype], "GFLOP/s", of, note=f"at {size} x {size}")
    return peaks


def pytest_sessionfinish(session: pytest.Session) -> None:
    results = session.config.stash.get(RESULTS, None)
    if results is not None and len(results.records) > 1:
        results.write(_target(session.config))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    results = config.stash.get(RESULTS, None)
    if results is None or len(results.records) <= 1:
        return
    terminalreporter.write_line("")
    terminalreporter.write_line(summary(results.records))
    if OLD in config.stash:
        terminalreporter.write_line("")
        terminalreporter.write_line(comparison(config.stash[OLD], results.records))
    terminalreporter.write_line(f"\n{_target(config)}")
