"""Tables of README and docs are drawn from docs/measured, whose files state commit and conditions truly."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from scripts.evidence import pages, plan, record
from scripts.evidence.readers import read_figures

from shift3d.accuracy_time import drive
from shift3d.analysis.tables.accuracy.cost import MEASURED

ROOT = Path(__file__).parents[3]
ENTRIES = {entry.name: entry for entry in plan.read_plan()}
RECORDS = sorted(path.stem for path in record.MEASURED.glob("*.json"))
UNMEASURED = yaml.safe_load((ROOT / "docs" / "scripts" / "evidence" / "unmeasured.yaml").read_text(encoding="utf-8"))
TO_BE_MEASURED = 5  # the list may shrink; lower this with it


@pytest.mark.parametrize("page", pages.PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_marked_table_is_what_its_figures_say(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert pages.drawn(text) == text, "run: make evidence ARGS=--draw"


def test_a_block_without_a_table_is_drawn_and_takes_nothing_of_what_follows() -> None:
    marks = "<!-- measured: open.code -->\n{}<!-- end -->\n"
    found = pages.drawn(marks.format("") + "\n## next\n\n" + marks.format("drawn before\n"))
    one, other = found.split("\n## next\n\n")
    assert one == other and "a package of" in one and "drawn before" not in one


def test_another_figure_draws_another_table(monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "guides" / "gate.md").read_text(encoding="utf-8")
    found = record.read("gate")
    found["figures"]["0.1/500 objects/found"]["value"] = 0.123
    monkeypatch.setattr(record, "read", lambda name: found)
    assert "12.3%" in pages.drawn(text) and "12.3%" not in text


@pytest.mark.parametrize(
    ("page", "shown", "times"),
    [("why/experiments.md", "| 71 | 0.800 | 0.400 | 0.51 | 93 % |", 5), ("open.md", "| 0.51; natural vehicles", 1)],
)
def test_what_is_measured_again_is_drawn_by_the_names_that_its_script_gives(
    page: str, shown: str, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Line names are the labels in the table of other scenes; the first one was written by hand."""
    labels = {"universal": {"descent_universal4, lambda 1": ["pointpillars"]}}
    labels["universal_natural"] = {
        f"{search}_family_within95_universal4, lambda 0": ["pointpillars", "sst"]
        for search in ("expectation", "random")
    }
    columns = {"placements": 71.0, "baseline": 0.8, "shape": 0.4, "ratio": 0.511, "lower in": 93.0}
    own = record.read

    def read(name: str) -> dict[str, Any]:
        figures = {
            f"elsewhere/shape, {label}, alpha 0.01, pointpillars {by}/{column}": {"value": value}
            for label, detectors in labels.get(name, {}).items()
            for by in detectors
            for column, value in columns.items()
        }
        return own(name) | ({"figures": figures} if figures else {})

    monkeypatch.setattr(record, "read", read)
    assert pages.drawn((ROOT / "docs" / page).read_text(encoding="utf-8")).count(shown) == times


def test_the_shapes_that_are_drawn_are_those_that_are_measured() -> None:
    shown = re.findall(r"adversarial, lambda (\d+)", (pages.TABLES / "naturalness.md.j2").read_text(encoding="utf-8"))
    assert f"attack.lambda={','.join(shown)} " in ENTRIES["naturalness"].command


def test_a_processor_without_bfloat16_leaves_its_row_out(monkeypatch: pytest.MonkeyPatch) -> None:
    text, found = (ROOT / "docs" / "why" / "accuracy.md").read_text(encoding="utf-8"), record.read("frontier")
    found["figures"] = {name: one for name, one in found["figures"].items() if "bfloat16" not in name}
    own = record.read
    monkeypatch.setattr(record, "read", lambda name: found if name == "frontier" else own(name))
    gone = [line for line in text.splitlines() if line not in pages.drawn(text).splitlines()]
    assert len(gone) == 1 and gone[0].startswith("| `bfloat16_band_m=0` |")


def test_a_frontier_depends_on_what_its_own_journal_depends_on() -> None:
    """A change in these folders makes `make frontier` measure again."""
    for name in ("frontier", "final_newton"):
        parts = [f"shift3d/{part}" if part.endswith(".py") else f"shift3d/{part}/*" for part in drive._CODE]
        assert set(parts) <= set(ENTRIES[name].depends)


def test_the_presets_that_ship_are_those_of_the_page() -> None:
    """A report's table of presets and docs/why/accuracy.md agree; after a new frontier: `shipped.py presets`."""
    measured = record.read("frontier")["figures"]
    for preset in json.loads(MEASURED.read_text(encoding="utf-8")):
        values = {"ms": preset["ms_median"], "times paper": preset["ratio_to_paper"]}
        for name, value in values.items():
            assert measured[f"{preset['setting']}/{name}"]["value"] == pytest.approx(value, rel=1e-3)


def test_every_number_of_a_table_is_drawn_or_listed_with_a_reason() -> None:
    listed = {(page, head) for part in UNMEASURED.values() for page, heads in part.items() for head in heads}
    found = {
        (str(page.relative_to(ROOT)), head)
        for page in pages.PAGES
        for head in pages.unmarked_tables(page.read_text(encoding="utf-8"))
    }
    assert found - listed == set(), (
        "draw them from docs/measured, or list them in docs/scripts/evidence/unmeasured.yaml"
    )
    assert listed - found == set(), "take them off docs/scripts/evidence/unmeasured.yaml"
    assert sum(map(len, UNMEASURED["to be measured"].values())) <= TO_BE_MEASURED


@pytest.mark.parametrize(
    ("row", "measured"),
    [("| a | 0.53 |", True), ("| a | 2,974 hits |", True), ("| a | 5 % |", True), ("| a | 3 of 4 |", True),
     ("| a | 14 min |", True), ("| a | Argoverse 2, 3D |", False), ("| a | `iou=0.7` |", False)],
)  # fmt: skip
def test_what_counts_as_a_measured_number(row: str, measured: bool) -> None:
    assert list(pages.unmarked_tables(f"text\n\n| x | y |\n|---|---|\n{row}\n\ntext")) == ["| x | y |"] * measured


@pytest.mark.parametrize("name", RECORDS)
def test_a_record_is_true_to_history(name: str) -> None:
    measured = record.read(name)["measured"]
    commit = measured["commit"] or measured["written_at"]
    try:
        if record.git("rev-parse", "--is-shallow-repository").strip() == "true":
            pytest.skip("a shallow checkout has no history to check against")
        record.git("rev-parse", "HEAD")
    except record.NoGitError:
        pytest.skip("no git checkout to check against")
    record.git("merge-base", "--is-ancestor", commit, "HEAD")  # raises if it is no ancestor
    if measured["commit"]:
        assert measured["digest"] == record.digest(measured["files"], commit)
    assert name in ENTRIES and str(Path.home()) not in str(measured["command"])


@pytest.mark.parametrize("name", RECORDS)
def test_a_figure_is_a_value_with_what_is_known_of_it(name: str) -> None:
    figures = record.read(name)["figures"]
    assert figures
    for one in figures.values():
        assert one.keys() <= {"value", "unit", "interval", "n"} and isinstance(one["value"], str | int | float)
        low, high = one.get("interval", (one["value"], one["value"]))
        assert low <= high


def test_a_changed_file_makes_figures_stale(monkeypatch: pytest.MonkeyPatch) -> None:
    entry, written = ENTRIES["gate"], record.read("gate")
    monkeypatch.setattr(record, "uncommitted", lambda globs: [])
    monkeypatch.setattr(record, "digest", lambda globs, commit="HEAD": written["measured"]["digest"])
    assert entry.state() == "current" and "\n0 minutes" in plan.table([entry])
    monkeypatch.setattr(record, "digest", lambda globs, commit="HEAD": "another")
    assert entry.state().startswith("stale: measured at") and f"\n{entry.minutes:g} minutes" in plan.table([entry])
    monkeypatch.setattr(record, "uncommitted", lambda globs: ["docs/scripts/gate.py"])
    assert "not committed" in entry.state()


@pytest.mark.parametrize("entry", ENTRIES.values(), ids=lambda entry: entry.name)
def test_an_entry_depends_on_files_and_keeps_paths_to_itself(entry: plan.Entry) -> None:
    rooms = ("docs", "shift3d", "sweeps", "conf", "tests")
    tracked = {str(path.relative_to(ROOT)) for room in rooms for path in (ROOT / room).rglob("*.*")}
    assert [glob for glob in entry.depends if not record.matching(tracked, [glob])] == []
    assert "{" not in entry.command and entry.minutes > 0
    scripts = [word for line in entry.run for word in line.split() if word.endswith(".py") and "/" in word]
    assert [word for word in scripts if not (ROOT / word).exists()] == []


def test_figures_are_read_from_each_kind_of_result(tmp_path: Path) -> None:
    import pandas as pd

    (tmp_path / "a.json").write_text('{"x": {"value": 1.5, "unit": "s", "low": 1, "high": 2}, "y": 3, "z": "no"}')
    rows = pd.DataFrame({"name": ["a", "b"], "v": [0.25, None], "w": [0.5, 1.0], "lo": [0.1, 0.2], "up": [0.9, 1.0]})
    rows.to_parquet(tmp_path / "a.parquet")
    specs = [
        {"json": "a.json"},
        {"rows": "a.parquet", "name": "{name}/", "values": {"v": ["v", "lo", "up"], "sum": ["v + w"]}},
        {"printed": r"^(?P<done>[\d,]+) passed"},
        {"count": "^case", "name": "cases"},
    ]
    found = read_figures(tmp_path, "case 1\ncase 2\n1,234 passed\n", specs)
    assert found == {
        "x": {"value": 1.5, "unit": "s", "interval": [1.0, 2.0]},
        "y": {"value": 3},
        "a/v": {"value": 0.25, "interval": [0.1, 0.9]},
        "a/sum": {"value": 0.75},
        "done": {"value": 1234},
        "cases": {"value": 2},
    }
    with pytest.raises(ValueError, match="nothing found"):
        read_figures(tmp_path, "", [{"printed": r"(?P<done>\d+) passed"}])
