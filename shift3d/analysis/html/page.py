"""A page that needs nothing but itself: its style, and pictures inside it."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["html_image", "html_table", "page", "png"]

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>TITLE</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
body { font: 15px/1.5 sans-serif; max-width: 78rem; margin: 2rem auto; padding: 0 1rem; color: #202020;
       background: #ffffff; }
p, dl { max-width: 50rem; }
img { max-width: 100%; height: auto; }
div { overflow-x: auto; }
table { border-collapse: collapse; font-size: 12px; font-variant-numeric: tabular-nums; white-space: nowrap; }
th, td { padding: 2px 7px; text-align: right; border-bottom: 1px solid #e4e4e4; }
th:first-child, td:first-child { text-align: left; }
.dominated td { color: #707070; }
.preset td:first-child { font-weight: bold; }
dt { float: left; clear: left; width: 6rem; font-weight: bold; }
dd { margin-left: 6.5rem; }
</style></head><body>
<h1>TITLE</h1>
BODY
</body></html>
"""


def page(title: str, body: Sequence[str]) -> str:
    """The whole page. title: plain text. body: parts, HTML."""
    return _PAGE.replace("TITLE", html.escape(title)).replace("BODY", "\n".join(body))


def html_table(header: Sequence[str], lines: Sequence[Sequence[str]], kinds: Sequence[str] | None = None) -> str:
    """A table of plain texts. kinds: a CSS class a line."""
    parts = ["<div><table><tr>" + "".join(f"<th>{html.escape(cell)}</th>" for cell in header)]
    for line, kind in zip(lines, kinds or [""] * len(lines), strict=True):
        cells = "".join(f"<td>{html.escape(cell)}</td>" for cell in line)
        parts.append(f'<tr class="{kind}">{cells}' if kind else f"<tr>{cells}")
    return "</tr>\n".join(parts) + "</tr></table></div>"


def html_image(figure: Figure, alt: str) -> str:
    """A figure as part of the page. alt: what it shows, for who cannot see it."""
    return f'<img src="data:image/png;base64,{base64.b64encode(png(figure)).decode()}" alt="{html.escape(alt)}">'


def png(figure: Figure) -> bytes:
    """A figure's picture; the same bytes for the same figure."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", metadata={"Software": ""})
    return picture.getvalue()
