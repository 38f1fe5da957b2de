"""docs/reference agrees with the code and the configuration."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

from shift3d.render.settings import RenderSettings
from shift3d.store.schemas import COLUMN_MEANINGS, SCHEMAS, TABLE_DESCRIPTIONS

ROOT = Path(__file__).parents[3]
MADE = runpy.run_path(str(ROOT / "docs" / "scripts" / "reference_pages.py"))


def test_the_pages_are_what_the_code_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for path, content in MADE["pages"]().items():
        assert path.read_text(encoding="utf-8") == content, f"{path.name}: run make docs"


def test_every_setting_has_a_meaning() -> None:
    rows = [line for line in MADE["settings_page"]().splitlines() if line.startswith("| `")]
    assert len(rows) > 80
    assert [row for row in rows if row.endswith("|  |")] == []
    assert all(MADE["render_meanings"]()[name] for name in RenderSettings.__dataclass_fields__)


def test_no_column_is_described_that_is_not_there() -> None:
    assert set(TABLE_DESCRIPTIONS) == set(SCHEMAS) and all(COLUMN_MEANINGS.values())
    assert set(COLUMN_MEANINGS) == {field.name for schema in SCHEMAS.values() for field in schema}
