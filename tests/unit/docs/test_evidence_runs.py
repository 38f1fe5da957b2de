"""A measurement runs in a clean checkout, records its commit, and is current until a file changes."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from scripts.evidence import record
from scripts.evidence.__main__ import measure, read_by_hand
from scripts.evidence.plan import Entry

ENTRY = Entry(
    "answer",
    ["python script.py {out} {data}"],
    ["script.py"],
    1,
    [{"printed": r"^answer (?P<answer>\d+)", "unit": "m"}, {"json": "more.json"}],
    {"WORD": "7"},
)
SCRIPT = """\
import os, pathlib, sys
pathlib.Path(sys.argv[1], "more.json").write_text('{"word": ' + os.environ["WORD"] + "}")
print("answer", 42 if sys.argv[2] == "given" else sys.exit(3))
"""


def commit(folder: Path, script: str) -> str:
    (folder / "script.py").write_text(script)
    for words in (["add", "script.py"], ["-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "a"]):
        subprocess.run(["git", *words], cwd=folder, check=True)
    record._blobs.cache_clear()
    return record.git("rev-parse", "HEAD").strip()


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    monkeypatch.setattr(record, "ROOT", tmp_path)
    monkeypatch.setattr(record, "MEASURED", tmp_path / "measured")
    (tmp_path / "measured").mkdir()
    yield tmp_path
    record._blobs.cache_clear()


def test_what_is_written_says_what_it_was_measured_at(checkout: Path) -> None:
    head = commit(checkout, SCRIPT)
    assert ENTRY.state() == "missing" and measure(ENTRY, {"data": "given"}) is None
    found = record.read("answer")
    assert found["figures"] == {"answer": {"value": 42, "unit": "m"}, "word": {"value": 7}}
    measured = found["measured"]
    assert measured["commit"] == head and measured["digest"] == record.digest(["script.py"], head)
    assert measured["command"] == "WORD=7 python script.py OUT DATA" and "cores" in measured["machine"]
    assert ENTRY.state() == "current"
    commit(checkout, SCRIPT + "# another\n")
    assert ENTRY.state() == f"stale: measured at {head[:7]}"


def test_files_that_are_not_committed_are_not_measured(checkout: Path) -> None:
    commit(checkout, SCRIPT)
    (checkout / "script.py").write_text(SCRIPT + "# changed\n")
    assert "commit first" in str(measure(ENTRY, {"data": "given"})) and ENTRY.state() == "missing"


def test_a_command_that_fails_writes_nothing(checkout: Path) -> None:
    commit(checkout, SCRIPT)
    assert "exit code 3" in str(measure(ENTRY, {"data": "other"})) and ENTRY.state() == "missing"


def test_measuring_afresh_forgets_what_was_left(checkout: Path) -> None:
    commit(checkout, SCRIPT)
    assert measure(ENTRY, {"data": "given"}) is None
    (left,) = (checkout / "outputs" / "evidence").iterdir()
    (left / "of an earlier run").touch()
    assert measure(ENTRY, {"data": "given"}, again=True) is None
    assert {path.name for path in left.iterdir()} == {"more.json", "seconds"}


def test_results_of_a_run_by_hand_are_of_the_commit_that_is_given(checkout: Path, tmp_path: Path) -> None:
    earlier = commit(checkout, SCRIPT)
    commit(checkout, SCRIPT + "# another\n")
    (tmp_path / "more.json").write_text('{"word": 8}')
    entry = Entry("answer", ["shift3d sweep x out={out}"], ["script.py"], 1, [{"json": "more.json"}])
    assert read_by_hand(entry, tmp_path, earlier[:7]) is None
    found = record.read("answer")
    assert found["figures"] == {"word": {"value": 8}} and found["measured"]["commit"] == earlier
    assert found["measured"]["digest"] == record.digest(["script.py"], earlier) and not found["measured"]["seconds"]
    assert entry.state().startswith("stale: measured at")
    (tmp_path / "more.json").unlink()
    assert "cannot be read" in str(read_by_hand(entry, tmp_path, earlier))
