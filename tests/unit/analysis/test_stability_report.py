"""The printed text of a verification counts every solution, and hides none that is unstable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from shift3d.analysis.html.sections.stability import write_stability_page
from shift3d.analysis.tables.accuracy.cost import diagnostics
from shift3d.analysis.tables.stability import stability_lines, stability_table
from shift3d.store.schemas import POSE_COLUMNS


def verification(unstable: int, stable: int) -> pd.DataFrame:
    rows = []
    for index in range(unstable + stable):
        bad = index < unstable
        rows.append(
            {"task_id": f"task{index:02d}", "vehicle": "suv", "scene": "street", "mode": "shape", "lambda": 1.0}
            | {"search": "descent", "alpha": 0.01, "detector": "pointpillars", "accuracy": "standard"}
            | {"scored_by": "pointpillars", "method": "adversarial", "replicate": 0, "score": 0.3}
            | {"score_again": 0.3, "score_reference": 0.5 if bad else 0.3001, "margin": 0.5, "stable": not bad}
            | {"least_margin_noise": 0.4, "least_margin_nearby": 0.4, "robust": index % 2 == 0}
            | {"cause": "of its <300> hits 9 missed" if bad else None}
        )  # fmt: skip
    return pd.DataFrame(rows)


def scores(**columns: list[float | None]) -> pd.DataFrame:
    count = len(next(iter(columns.values())))
    base: dict[str, list[Any]] = {
        "task_id": [str(i) for i in range(count)],
        "method": ["adversarial"] * count,
        "replicate": [0] * count,
    }
    base |= {name: ["same"] * count for name in ("dataset", "scene", "vehicle", "detector", "accuracy")}
    base |= {"effects": [[]] * count, **{name: [0.0] * count for name in POSE_COLUMNS}}
    values = {"max_residual_m": [1e-6] * count, "unresolved_beams": [0] * count, "non_finite": [0] * count}
    return pd.DataFrame(base | values | {"least_slope": [0.1] * count, "grazing_gradient": [0.2] * count} | columns)


def test_every_unstable_solution_is_counted_and_named_with_its_cause(tmp_path: Path) -> None:
    frame = verification(unstable=12, stable=28)
    text = stability_lines(frame)
    assert "12 unstable" in text and "70.0%" in text and "2.0e-01" in text
    assert text.count("of its <300> hits 9 missed") == 10 and "and 2 more in verification.parquet" in text
    page = write_stability_page(tmp_path / "stability.html", "a <sweep>", scores(non_finite=[0]), frame).read_text()
    assert page.count("of its &lt;300&gt; hits 9 missed") == 12 and "a &lt;sweep&gt;" in page and "<300>" not in page
    again = write_stability_page(tmp_path / "again.html", "a <sweep>", scores(non_finite=[0]), frame).read_text()
    assert page == again


def test_solutions_of_other_settings_have_lines_of_their_own() -> None:
    one = verification(unstable=1, stable=3)
    both = pd.concat([one, verification(unstable=0, stable=4).assign(search="evolution", alpha=0.1)])
    lines = stability_table(both).lines
    assert [line[0] for line in lines] == ["adversarial, descent, alpha 0.01", "adversarial, evolution, alpha 0.1"]
    assert [line[4:6] for line in lines] == [["4", "1"], ["4", "0"]]
    (alone,) = stability_table(one).lines
    assert alone[0] == "adversarial"


def test_nothing_unstable_is_said_so(tmp_path: Path) -> None:
    frame = verification(unstable=0, stable=3)
    assert "unstable\n" not in stability_lines(frame)
    assert "<p>None.</p>" in write_stability_page(tmp_path / "p.html", "s", scores(non_finite=[0]), frame).read_text()


def test_diagnostics_add_up_over_objects() -> None:
    text = diagnostics(scores(non_finite=[0, 2], unresolved_beams=[1, 4], least_slope=[0.3, 0.02]))
    assert text.startswith("Numerics over 2 objects: 2 non-finite values, 5 unresolved beams; at hits the distance ")
    assert "at most 0.001 mm" in text
    assert "slope along the beam is at least 0.02;" in text and "20% of the gradient" in text


@pytest.mark.parametrize("residual", [[], [None]])
def test_no_object_is_said_so(residual: list[None]) -> None:
    assert diagnostics(scores(max_residual_m=residual)) == "Numerics: no object was rendered."
