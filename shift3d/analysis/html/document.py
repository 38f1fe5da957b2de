"""A page that needs nothing but itself, from its sections."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined

from shift3d.analysis.html.blocks import Block, Section


@cache
def _templates() -> Environment:
    loader = PackageLoader("shift3d.analysis.html")
    made = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    made.filters["kind"] = lambda block: type(block).__name__
    return made


def document(title: str, sections: Sequence[Section], lead: str = "", library: str = "") -> str:
    """The whole page; every text is escaped.

    title, lead: plain text. library: JavaScript that draws the plots, put into the page once; a page without plots
    needs none and has no script at all.
    """
    page = _templates().get_template("page.html")
    return page.render(title=title, lead=lead, sections=sections, library=library) + "\n"


def blocks_html(blocks: Sequence[Block]) -> str:
    """Some blocks alone, as they stand in a page."""
    blocks_template = _templates().get_template("blocks.html")
    return str(blocks_template.module.show(blocks))  # type: ignore[attr-defined]
