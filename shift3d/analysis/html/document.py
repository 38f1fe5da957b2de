"""Self-contained HTML page, rendered from its sections."""

from __future__ import annotations

from collections.abc import Sequence

from jinja2 import Environment, PackageLoader, StrictUndefined

from shift3d.analysis.html.blocks import Section
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike, as_location

_TEMPLATES = Environment(
    loader=PackageLoader("shift3d.analysis.html"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.filters["kind"] = lambda block: type(block).__name__


def document(title: str, sections: Sequence[Section], lead: str = "", library: str = "") -> str:
    """Render the whole page; every text is escaped.

    title, lead: plain text. library: JavaScript that draws the plots, embedded once; without it the page has no script.
    """
    page = _TEMPLATES.get_template("page.html")
    return page.render(title=title, lead=lead, sections=sections, library=library) + "\n"


def write_page(path: LocationLike, page: str) -> Location:
    """Write a page atomically. Returns its path. Raises: InputError: the disk is full or not writable."""
    location = as_location(path)
    location.write_atomic(page.encode())
    return location
