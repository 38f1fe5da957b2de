"""A sweep in which no vehicle found a place reports that first, and ends with its own exit code."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from shift3d.analysis.tables.coverage import no_placement_message
from shift3d.cli.main import main
from shift3d.exit_codes import ExitCode

PLACEMENT = {
    "attempts": 2,
    "min_object_points": 300,
    "min_range_m": 15.0,
    "max_range_m": 50.0,
    "contact_m": 0.02,
    "overlap_m": 0.02,
}
SETTINGS = {"attack": {"placement": PLACEMENT}}


def test_only_a_sweep_without_any_place_is_one() -> None:
    def scores(*status: str) -> pd.DataFrame:
        return pd.DataFrame({"task_id": list("abc")[: len(status)], "status": list(status)})

    assert no_placement_message(scores(), SETTINGS) is None, "every task was quarantined"
    assert no_placement_message(scores("ok", "no_placement"), SETTINGS) is None
    assert "all 2 tasks" in str(no_placement_message(scores("no_placement", "no_placement"), SETTINGS))


def test_nothing_fitted_is_said_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    one = ["smoke", "vehicle=suv", "mode=pose", "accuracy.render.sdf_grid=false", "runner=local", "tracking=none"]
    nowhere = ["attack.placement.min_object_points=100000", "attack.placement.attempts=1", "out=out"]
    assert main(["sweep", *one, *nowhere]) == ExitCode.INCOMPLETE == 3
    _, printed = capsys.readouterr().out.split("writing to out\n")
    first = printed.strip().splitlines()[0]
    assert first.startswith("no vehicle found a place") and "attack.placement.min_object_points" in first
    assert "verify" not in printed and "AUC" not in printed and "0 of 1 task scored" in printed
    assert "places for a car, 1 draw per scene:\n  street-test-hdl64-000000: 0 of 1 free; " in printed
    assert main(["report", "out"]) == 0
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.index("no vehicle found a place") < page.index("<table")
    assert "A trial: these AUCs" not in page, "there are none"
