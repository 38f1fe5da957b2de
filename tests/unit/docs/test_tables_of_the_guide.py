"""The guide's three lines for pandas, polars and duckdb give the table of AUC that the sweep printed."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import valid_sweeps

from shift3d.store.log_entries import read_log
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.results.final import FinalTables, write_final

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "guides" / "report.md"
PLACE = "outputs/default-..."
TO_ROWS = {
    "pandas": "rows = table.reset_index().to_dict('records')",
    "polars": "rows = table.to_dicts()",
    "duckdb": "rows = table.df().to_dict('records')",
}


def snippets() -> dict[str, str]:
    """Return library to its lines in the guide."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    return {name: block for block in blocks for name in TO_ROWS if re.match(rf"import {name}\b", block)}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FinalTables]:
    folder = tmp_path_factory.mktemp("readme") / "sweep"
    valid_sweeps.write_sweep(folder)
    return folder, write_final(folder, read_plan(folder), read_log(folder))


@pytest.mark.parametrize("library", TO_ROWS)
def test_three_lines_reproduce_the_table(library: str, finished: tuple[Path, FinalTables], tmp_path: Path) -> None:
    folder, final = finished
    lines = snippets()[library]
    assert len([line for line in lines.splitlines() if line]) == 3 and PLACE in lines
    script = tmp_path / "lines.py"
    show = f"{TO_ROWS[library]}\nimport json\nprint('ROWS', json.dumps(rows))\n"
    script.write_text(lines.replace(PLACE, str(folder)) + show)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.split("ROWS ", 1)[1])
    auc = final.frame("auc")
    expected = {(row.method, row.vehicle): row.auc for row in auc[auc["selected"]].itertuples()}
    assert {row["method"] for row in found} == {method for method, _ in expected} and len(found) == 3
    for row in found:
        assert (row["mode"], row["scored_by"]) == ("shape", "pointpillars")
        assert math.isclose(row["suv"], expected[row["method"], "suv"], abs_tol=1e-12)


def test_the_extra_that_the_guide_names_brings_what_its_lines_import() -> None:
    text = PAGE.read_text()
    (extra,) = re.findall(r"pip install -c constraints\.txt -e '\.\[(\w+)\]'", text)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    brought = {re.split(r"\W", name)[0] for name in project["dependencies"] + project["optional-dependencies"][extra]}
    assert set(snippets()) <= brought
