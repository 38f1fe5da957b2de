"""What a page is made of: plain data, which ``templates/blocks.html`` makes HTML of."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from shift3d.analysis.tables.table import Table


@dataclass(frozen=True)
class Paragraph:
    """A paragraph. kind: a CSS class."""

    text: str
    kind: str = ""


def missing(text: str) -> Paragraph:
    """A paragraph on what there is not."""
    return Paragraph(text, "missing")


@dataclass(frozen=True)
class Heading:
    """A heading within a section."""

    text: str


@dataclass(frozen=True)
class Items:
    """A list."""

    texts: Sequence[str]


@dataclass(frozen=True)
class Terms:
    """Terms and what they mean."""

    meanings: Mapping[str, str]


@dataclass(frozen=True)
class Command:
    """A command to copy, after a few words."""

    lead: str
    command: str


@dataclass(frozen=True)
class Fold:
    """What is shown when it is asked for."""

    summary: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Panels:
    """Blocks side by side where there is room. kind: "wide", "tiles" or nothing."""

    blocks: Sequence[Block]
    kind: str = ""


@dataclass(frozen=True)
class Article:
    """Blocks with a heading and a border of their own. key: unique in the page."""

    key: str
    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Picture:
    """A PNG inside the page; nothing where there is none. alt: what it shows, for who cannot see it."""

    png: bytes | None
    alt: str
    caption: str = ""

    @property
    def address(self) -> str:
        """The picture as an address that needs no network."""
        return f"data:image/png;base64,{base64.b64encode(self.png or b'').decode()}"


@dataclass(frozen=True)
class Plot:
    """A figure that the page's script draws, see `figure.plot`. data: JSON that is safe within a script element."""

    key: str
    data: str
    label: str
    caption: str
    height_px: int
    pair: str


@dataclass(frozen=True)
class TurnButtons:
    """Buttons that turn a 3D view, and its pair with it, without a mouse. key: of the `Plot`. name: of the views."""

    key: str
    name: str


Block = Paragraph | Heading | Items | Terms | Command | Fold | Panels | Article | Picture | Plot | TurnButtons | Table
"""Each has a part of the template by its name."""


@dataclass(frozen=True)
class Section:
    """A part of the page. key: its id, for links."""

    key: str
    title: str
    blocks: Sequence[Block]


def folded(parts: Sequence[tuple[str, Sequence[Block]]], shown: int) -> list[Block]:
    """Parts by their summary, the first ``shown`` in sight and the others folded."""
    blocks: list[Block] = [block for _, part in parts[:shown] for block in part]
    return [*blocks, *(Fold(summary, part) for summary, part in parts[shown:])]
