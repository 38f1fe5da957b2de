"""No file can make shift3d run code: nothing is unpickled, evaluated, or called because a configuration names it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[3]
SOURCES = sorted((REPOSITORY / "shift3d").rglob("*.py"))
SETTINGS = sorted(path for name in ("conf", "sweeps", "jobs") for path in (REPOSITORY / name).rglob("*.yaml"))
# Modules whose readers run code of a file; Hydra's would call the object that _target_ names.
MODULES = {"pickle", "cPickle", "_pickle", "cloudpickle", "dill", "joblib", "marshal", "shelve", "hydra.utils"}
HARMLESS = "from pickle import UnpicklingError"  # raised by torch.load when it refuses a pickle
BUILTINS = {"eval", "exec", "compile", "__import__"}
YAML = {"load", "load_all", "full_load", "unsafe_load"}


def findings(source: str) -> Iterator[str]:
    """Yield places in a module that could run code from a file."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (f"imports {alias.name}" for alias in node.names if alias.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module and ast.unparse(node) != HARMLESS:
            names = {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
            yield from (f"imports {name}" for name in sorted(names & MODULES))
        elif isinstance(node, ast.Call):
            yield from _of_call(node)


def _of_call(node: ast.Call) -> Iterator[str]:
    passed = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
    match node.func:
        case ast.Name(id=name) if name in BUILTINS:
            yield f"calls {name}"
        case ast.Attribute(value=ast.Name(id="torch"), attr="load") if passed.get("weights_only") != "True":
            yield "torch.load without weights_only=True"
        case ast.Attribute(value=ast.Name(id="np"), attr="load") if passed.get("allow_pickle", "False") != "False":
            yield "np.load with pickles"
        case ast.Attribute(value=ast.Name(id="yaml"), attr=name) if name in YAML:
            yield f"yaml.{name}"


def test_no_module_runs_what_a_file_says() -> None:
    found = {str(path.relative_to(REPOSITORY)): list(findings(path.read_text())) for path in SOURCES}
    assert len(found) > 100
    assert {name: what for name, what in found.items() if what} == {}


def test_no_configuration_names_code_to_call() -> None:
    assert SETTINGS
    assert [path.name for path in SETTINGS if "_target_" in path.read_text()] == []
    assert [path.name for path in SOURCES if '"_target_"' in path.read_text()] == []


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import loads",
        "from hydra.utils import instantiate",
        "import os, joblib",
        "eval('1')",
        "torch.load('x')",
        "torch.load('x', weights_only=False)",
        "np.load('x', allow_pickle=True)",
        "yaml.load(text)",
        "def f():\n    import dill",
    ],
)
def test_what_would_run_code_is_found(source: str) -> None:
    assert list(findings(source))


def test_what_reads_data_alone_is_not() -> None:
    assert not list(findings("torch.load('x', weights_only=True); np.load('x'); yaml.safe_load(text); re.compile('x')"))
