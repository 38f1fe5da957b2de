"""Building blocks of a page: plain data that ``templates/blocks.html`` renders to HTML."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from shift3d.analysis.tables.table import Table


@dataclass(frozen=True)
class Paragraph:
    """Paragraph. kind: a CSS class."""

    text: str
    kind: str = ""


def missing(text: str) -> Paragraph:
    """Return a paragraph about missing content."""
    return Paragraph(text, "missing")


@dataclass(frozen=True)
class Heading:
    """Heading within a section."""

    text: str


@dataclass(frozen=True)
class Items:
    """Bulleted list."""

    texts: Sequence[str]


@dataclass(frozen=True)
class Terms:
    """Definition list: terms and their meanings."""

    meanings: Mapping[str, str]


@dataclass(frozen=True)
class Command:
    """Command to copy, after an introduction."""

    lead: str
    command: str


@dataclass(frozen=True)
class Collapsible:
    """Collapsible block: only its summary is initially visible."""

    summary: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Panels:
    """Blocks side by side, if there is room. kind: "wide", "tiles" or empty."""

    blocks: Sequence[Block]
    kind: str = ""


@dataclass(frozen=True)
class Article:
    """Blocks with their own heading and border. key: unique in the page."""

    key: str
    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Picture:
    """PNG embedded in the page. png: None shows `alt` instead. alt: description for readers who cannot see it."""

    png: bytes | None
    alt: str
    caption: str = ""

    @property
    def address(self) -> str:
        """Data URI of the picture, which needs no network."""
        return f"data:image/png;base64,{base64.b64encode(self.png or b'').decode()}"


@dataclass(frozen=True)
class Plot:
    """Figure that the page's script draws, see `figure.plot`. data: JSON that is safe within a script element."""

    key: str
    data: str
    label: str
    caption: str
    height_px: int
    pair: str


@dataclass(frozen=True)
class TurnButtons:
    """Buttons that rotate a 3D view and its pair without a mouse. key: of the `Plot`. name: of the views."""

    key: str
    name: str


# The template renders each type by its name.
Block = (
    Paragraph
    | Heading
    | Items
    | Terms
    | Command
    | Collapsible
    | Panels
    | Article
    | Picture
    | Plot
    | TurnButtons
    | Table
)


@dataclass(frozen=True)
class Section:
    """Section of the page. key: its id, for links."""

    key: str
    title: str
    blocks: Sequence[Block]


def folded(parts: Sequence[tuple[str, Sequence[Block]]], shown: int) -> list[Block]:
    """Show the first ``shown`` parts and fold the others under their summaries."""
    blocks: list[Block] = [block for _, part in parts[:shown] for block in part]
    return [*blocks, *(Collapsible(summary, part) for summary, part in parts[shown:])]
