"""The page around the sections: its skeleton, and the HTML of tables, terms and asides."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from shift3d.analysis.html.script import SCRIPT
from shift3d.analysis.html.style import STYLE

__all__ = ["OPEN", "Markup", "Section", "aside", "document", "escape", "paragraph", "table", "terms"]

# Nothing is fetched, whatever a library would like to fetch.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; form-action 'none'"
)


OPEN = 4
"""Variants of a sweep whose tables are in sight; those of the others unfold."""


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


@dataclass(frozen=True)
class Section:
    """A part of the page. key: its id, for links. title: plain text. body: HTML."""

    key: str
    title: str
    body: Sequence[str]


def escape(text: str) -> str:
    """Plain text as HTML; Markup as it is."""
    return str(text) if isinstance(text, Markup) else html.escape(str(text))


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph. kind: a CSS class; "missing" for what the sweep does not have."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def table(
    caption: str, header: Sequence[str], lines: Sequence[Sequence[str]], kinds: Sequence[str] | None = None
) -> str:
    """A table with a caption, column heads, and the first cell of each line as its head.

    It scrolls within itself, by keyboard too. header, lines: plain text or Markup. kinds: a CSS class a line.
    """
    heads = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in header)
    body = []
    for line, kind in zip(lines, kinds or [""] * len(lines), strict=True):
        cells = f'<th scope="row">{escape(line[0])}</th>' + "".join(f"<td>{escape(cell)}</td>" for cell in line[1:])
        body.append(f'<tr class="{kind}">{cells}</tr>' if kind else f"<tr>{cells}</tr>")
    label = html.escape(f"Table: {caption}")
    return (
        f'<div class="scroll" role="region" tabindex="0" aria-label="{label}">'
        f"<table><caption><span>{escape(caption)}</span></caption><thead><tr>{heads}</tr></thead><tbody>\n"
        + "\n".join(body)
        + "\n</tbody></table></div>"
    )


def terms(meanings: Mapping[str, str]) -> str:
    """Terms and what they mean."""
    parts = (f"<div><dt>{escape(name)}</dt><dd>{escape(text)}</dd></div>" for name, text in meanings.items())
    return f"<dl>{''.join(parts)}</dl>"


def aside(summary: str, body: Sequence[str]) -> str:
    """What is shown when it is asked for."""
    return f"<details><summary>{escape(summary)}</summary>\n{_joined(body)}\n</details>"


def document(title: str, lead: str, sections: Sequence[Section], library: str) -> str:
    """The whole page.

    title, lead: plain text. library: JavaScript that draws the figures, put into the page once.
    """
    links = "".join(f'<li><a href="#{part.key}">{escape(part.title)}</a></li>' for part in sections)
    body = "\n".join(
        f'<section aria-labelledby="{part.key}"><h2 id="{part.key}">{escape(part.title)}</h2>\n'
        f"{_joined(part.body)}\n</section>"
        for part in sections
    )
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        f"<title>{escape(title)}</title>\n"
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<style>{STYLE}</style></head><body>\n"
        '<a class="skip" href="#main">Skip to the results</a>\n'
        f"<header><h1>{escape(title)}</h1>\n{paragraph(lead)}\n"
        "<noscript><p>The figures need JavaScript; the tables hold the numbers without it.</p></noscript></header>\n"
        f'<nav aria-label="Sections"><ul>{links}</ul></nav>\n'
        f'<main id="main" tabindex="-1">\n{body}\n</main>\n'
        "<footer><p>Made by shift3d from the tables in final/. Method: SHIFT3D, ICCV 2023.</p></footer>\n"
        f"<script>{library}</script>\n<script>{SCRIPT}</script>\n</body></html>\n"
    )


def _joined(parts: Sequence[str]) -> str:
    return "\n".join(part for part in parts if part)
