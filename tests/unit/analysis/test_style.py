"""The pages' style sheet has no rule for elements that no page has."""

from __future__ import annotations

import re
from pathlib import Path

from shift3d.analysis.html import document

TEMPLATES = Path(document.__file__).parent / "templates"
PACKAGE = TEMPLATES.parents[2]


def test_every_rule_is_of_a_tag_or_class_that_pages_have() -> None:
    markup = "".join(file.read_text() for file in TEMPLATES.glob("*.html"))
    code = "".join(file.read_text() for room in ("analysis", "finetuning") for file in (PACKAGE / room).rglob("*.py"))
    code += (TEMPLATES / "script.js").read_text()
    rules = re.findall(r"([^{}]+)\{[^{}]*\}", (TEMPLATES / "style.css").read_text())
    parts = [part for rule in rules for part in re.split(r"[\s,>]+", rule.strip())]
    tags = {found[0] for part in parts if (found := re.match(r"[a-z]+\d?", part))}
    classes = {name for part in parts for name in re.findall(r"\.([a-z]+)", part)}
    assert {"table", "h1", "dt"} <= tags and {"plot", "ours", "wide"} <= classes
    assert [tag for tag in sorted(tags) if not re.search(rf"<{tag}[\s>]", markup)] == []
    used = {name for text in re.findall(r'class="([^"]*)"', re.sub(r"{%.*?%}", "", markup)) for name in text.split()}
    assert [name for name in sorted(classes - used) if f'"{name}"' not in code] == []
