"""All settings on a case: each quantity measured once, in turns, and the same rows after any interruption."""

from __future__ import annotations

from pathlib import Path

import pytest
from frontier_settings_by_hand import FakeInstrument, StoppedError, setting

from shift3d.accuracy_time.journal import Journal
from shift3d.accuracy_time.rows import CaseResults, frontier_rows
from shift3d.accuracy_time.run import RepeatLimits, expected_seconds, measure_case
from shift3d.store.frontier_table import frontier_table

REPEATS = RepeatLimits(most=4, seconds=10.0, slow_s=30.0)
SETTINGS = [
    setting("standard", preset="standard", steps=3),
    setting("paper", "paper", preset="paper", crop_m=None, displaced=False),
    setting("crop 5 m", crop_m=5.0, steps=2),
    setting("detector in float64", detector="float64"),
    setting("plain", "plain_sphere_tracing", method="plain", knob=0.1, knob_name="step_m", attack_steps=15),
]


def rows_of(journal: Path, instrument: FakeInstrument) -> list[dict[str, object]]:
    results = measure_case(SETTINGS, instrument, Journal(journal), REPEATS)
    return frontier_rows(SETTINGS, [CaseResults("street", 1000, results)])


def test_an_interrupted_run_taken_up_again_gives_the_same_rows_and_repeats_nothing(tmp_path: Path) -> None:
    whole = FakeInstrument(slow=frozenset({"paper"}))
    expected = rows_of(tmp_path / "whole.jsonl", whole)
    frontier_table(expected)
    for stop_after in range(len(whole.calls)):
        path = tmp_path / f"{stop_after}.jsonl"
        first = FakeInstrument(stop_after, frozenset({"paper"}))
        with pytest.raises(StoppedError):
            rows_of(path, first)
        second = FakeInstrument(slow=frozenset({"paper"}))
        assert rows_of(path, second) == expected
        assert first.calls + second.calls == whole.calls


def test_a_kill_in_the_middle_of_a_line_costs_that_measurement_alone(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    expected = rows_of(path, FakeInstrument())
    content = path.read_bytes()
    path.write_bytes(content[:-20])
    again = FakeInstrument()
    assert rows_of(path, again) == expected
    assert len(again.calls) == 1 and path.read_bytes() == content


def test_settings_that_render_the_same_share_their_times_and_tie(tmp_path: Path) -> None:
    instrument = FakeInstrument()
    rows = {row["setting"]: row for row in rows_of(tmp_path / "journal.jsonl", instrument)}
    assert {name for what, name in instrument.calls if what == "sample"} == {"standard", "paper", "plain"}
    for name in ("crop 5 m", "detector in float64"):
        assert rows[name]["ms_median"] == rows["standard"]["ms_median"]
    # It has its own attack step, but not its own displaced rendering: the score is float32's in both.
    assert ("look", "crop 5 m") in instrument.calls and ("displaced", "crop 5 m") not in instrument.calls
    assert ("displaced", "detector in float64") in instrument.calls


def test_timings_take_turns(tmp_path: Path) -> None:
    instrument = FakeInstrument()
    rows_of(tmp_path / "journal.jsonl", instrument)
    samples = [name for what, name in instrument.calls if what == "sample"]
    assert samples == ["standard", "paper", "plain", "plain", "paper", "standard"] * 2


def test_what_is_slow_is_rendered_once(tmp_path: Path) -> None:
    instrument = FakeInstrument(slow=frozenset({"paper"}))
    rows = {row["setting"]: row for row in rows_of(tmp_path / "journal.jsonl", instrument)}
    assert [what for what, name in instrument.calls if name == "paper"] == ["look"]
    assert rows["paper"]["ms_low"] == rows["paper"]["ms_median"] == rows["paper"]["ms_high"] == 60_000.0
    assert rows["paper"]["ratio_to_paper"] == 1.0 and rows["standard"]["ratio_to_paper"] > 1000


def test_as_many_attack_steps_as_asked_for_the_first_look_among_them(tmp_path: Path) -> None:
    instrument = FakeInstrument()
    rows_of(tmp_path / "journal.jsonl", instrument)
    steps = [name for what, name in instrument.calls if what == "step"]
    assert sorted(steps) == ["crop 5 m", "standard", "standard"]


def test_what_is_told_adds_up_to_what_is_expected(tmp_path: Path) -> None:
    reported = []
    measure_case(
        SETTINGS,
        FakeInstrument(),
        Journal(tmp_path / "j"),
        REPEATS,
        lambda name, seconds, known: reported.append(seconds),
    )
    assert sum(reported) == pytest.approx(expected_seconds(SETTINGS, 1), rel=0.3)


def test_a_journal_gives_back_what_was_put(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "deep" / "j")
    journal.put("a", {"x": [1, 0.1], "y": None})
    assert "a" in Journal(tmp_path / "deep" / "j") and Journal(tmp_path / "deep" / "j")["a"] == {
        "x": [1, 0.1],
        "y": None,
    }
    with pytest.raises(ValueError):
        journal.put("b", float("nan"))
