"""Pages show every given block."""

from __future__ import annotations

import jinja2
import pytest

from shift3d.analysis.html.blocks import Collapsible, Command, Heading, Items, Paragraph, Section, Terms
from shift3d.analysis.html.document import document


def test_every_block_is_on_the_page_with_its_text_escaped() -> None:
    inner = [Paragraph("<one>"), Heading("two"), Items(["three"]), Terms({"four": "five"}), Command("six", "seven")]
    page = document("title", [Section("key", "section", [Collapsible("more", inner)])])
    for text in ("&lt;one&gt;", "two", "three", "four", "five", "six", "seven", "more", "section", "title"):
        assert text in page
    assert "<one>" not in page


def test_a_block_that_no_template_knows_is_an_error() -> None:
    with pytest.raises(jinja2.UndefinedError):
        document("title", [Section("key", "section", [object()])])  # type: ignore[list-item]
