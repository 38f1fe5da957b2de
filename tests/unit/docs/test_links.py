"""Every page's links and pictures exist, and the README stays short."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
README_WORDS = 900


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_links_to_is_there(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    local = [target for target in targets if "://" not in target]
    assert [target for target in local if not (page.parent / target).exists()] == []


def test_every_page_is_reached_from_the_readme() -> None:
    found, left = set(), [ROOT / "README.md"]
    while left:
        page = left.pop()
        if page in found:
            continue
        found.add(page)
        targets = re.findall(r"\]\(([^)#\s]+\.md)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
        left += [(page.parent / target).resolve() for target in targets]
    assert {str(page.relative_to(ROOT)) for page in PAGES} == {str(page.relative_to(ROOT)) for page in found}


def test_the_readme_is_read_in_minutes() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= README_WORDS


def test_files_that_the_architecture_names_are_there() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    known = {*tracked, *(parent for name in tracked for parent in map(str, Path(name).parents))}
    if not tracked:
        pytest.skip("no git checkout")
    named = re.findall(r"`([a-z_]+/[\w/.]*)`", text)
    assert len(named) > 30
    missing = [
        name
        for name in named
        if not {name.rstrip("/"), f"shift3d/{name.rstrip('/')}"} & known and not re.search(r"[A-Z]{4}", name)
    ]
    assert missing == []


def test_files_that_code_and_settings_name_are_there() -> None:
    """Help, messages and comments refer to pages and settings files, which must exist."""
    texts = [path for room in ("shift3d", "conf", "sweeps", "jobs") for path in (ROOT / room).rglob("*.[py]*")]
    named = {
        (name, str(path.relative_to(ROOT)))
        for path in texts
        if path.suffix in (".py", ".yaml")
        for name in re.findall(r"\b(?:docs|sweeps|conf|jobs)/[a-z_0-9/]+\.(?:md|yaml)\b", path.read_text("utf-8"))
    }
    assert len(named) > 10
    assert sorted(pair for pair in named if not (ROOT / pair[0]).exists()) == []
