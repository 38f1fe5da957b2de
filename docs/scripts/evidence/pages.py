"""Tables of README and docs, drawn from docs/measured.

A page marks a block: ``<!-- measured: TEMPLATE.MACRO WORD ... -->``, the drawn text, ``<!-- end -->``.
tables/TEMPLATE.md.j2 defines the macro, which takes the words as arguments. In a macro, ``figures(NAME)`` returns the
figures of docs/measured/NAME.json, ``at(NAME)`` the sentence that states commit, place and method of their measurement.
"""

from __future__ import annotations

import functools
import re
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jinja2
from scripts.evidence import record

PAGES = sorted(
    [record.ROOT / "README.md", *(p for p in (record.ROOT / "docs").rglob("*.md") if p.parent.name != "reference")]
)
TABLES = Path(__file__).parent / "tables"
_BLOCK = re.compile(r"(<!-- ?measured: ?([^>]*?) ?-->\n)(.*?)\n?(<!-- ?end ?-->)", re.DOTALL)
_TABLE = re.compile(r"^\|.*(?:\n\|.*)+$", re.MULTILINE)
# A measured number has a fraction, a thousands separator, a per cent sign or a unit, or has the form "3 of 40".
_NUMBER = re.compile(
    r"(?<![\w.])\d[\d,]*\.\d|(?<!\w)\d{1,3},\d{3}\b|\d ?%|\d of \d"
    r"|(?<![\w.])\d+ (?:[mµ]?s|min|minutes|hours?|[MkG]B|[cm]m)\b"
)


def drawn(text: str) -> str:
    """Return the page with every marked block drawn from its figures."""
    return _BLOCK.sub(lambda match: f"{match[1]}{_draw(match[2])}\n{match[4]}", text)


def draw() -> list[Path]:
    """Draw every page. Returns the pages that changed."""
    from shift3d.store.atomic import write_atomic

    changed = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        if (new := drawn(text)) != text:
            write_atomic(page, new.encode())
            changed.append(page)
    return changed


def unmarked_tables(text: str) -> Iterator[str]:
    """Yield the first lines of tables that hold a measured number outside marked blocks. Code blocks do not count."""
    rest = re.sub(r"```.*?```", "", _BLOCK.sub("", text), flags=re.DOTALL)
    for table in _TABLE.findall(rest):
        head, _, *rows = table.splitlines()
        if any(_NUMBER.search(re.sub(r"`[^`]*`|\]\([^)]*\)", "", row)) for row in rows):
            yield head


def _draw(call: str) -> str:
    name, *words = call.split()
    template, _, macro = name.partition(".")
    module = _environment().get_template(f"{template}.md.j2").module
    lines = [line.rstrip() for line in str(getattr(module, macro)(*words)).strip().splitlines()]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines))


@functools.cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TABLES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=False,
    )
    environment.globals |= {"figures": _figures, "at": _at, "paper": _paper, "groups": _groups, "sides": _sides}
    environment.globals["elsewhere"] = _elsewhere
    environment.filters |= {"num": _number, "between": _between, "both": _both}
    return environment


def _figures(name: str) -> Mapping[str, Any]:
    return record.read(name)["figures"]  # type: ignore[no-any-return]


def _number(one: Mapping[str, Any], digits: int = 0, times: float = 1.0) -> str:
    value = one["value"]
    return value if isinstance(value, str) else f"{value * times:,.{digits}f}"


def _between(one: Mapping[str, Any], digits: int = 3, times: float = 1.0) -> str:
    """Return the interval in brackets, or an empty text if it is unknown."""
    return "[{}]".format(", ".join(f"{end * times:.{digits}f}" for end in one["interval"])) if "interval" in one else ""


def _both(one: Mapping[str, Any], digits: int = 3) -> str:
    return f"{_number(one, digits)} {_between(one, digits)}".strip()


def _at(*names: str) -> str:
    return textwrap.fill(" ".join(_sentence(record.read(name)["measured"]) for name in names), 120)


def _sentence(measured: Mapping[str, Any]) -> str:
    took = [f"{max(1, round(measured['seconds'] / 60))} min"] if measured.get("seconds") else []
    known = ", ".join([measured["machine"] or "machine not recorded", *took])
    where = f"Measured at commit {(measured['commit'] or '')[:7]} ({known})"
    if not measured["commit"]:
        where = f"Written down at commit {measured['written_at'][:7]} ({known}; the commit measured is not recorded)"
    return f"{where}: `{measured['command']}`." if measured.get("command") else f"{where}."


def _paper(mode: str, detector: str, scored_by: str) -> Mapping[str, Any]:
    """Return the paper's AUCs by method and vehicle, with mean and share of the baseline; empty without a table."""
    from shift3d.analysis.tables.paper import paper_table

    table = paper_table(mode, detector, scored_by)
    if table is None:
        return {}
    found: dict[str, Any] = {}
    for method, of in table.aucs.by_method.items():
        names = list(of)
        more = {"mean": table.aucs.mean(method, names), "of baseline": table.aucs.ratio_to_baseline(method, names)}
        found[method] = {key: {"value": value} for key, value in {**of, **more}.items() if value is not None}
    return found


def _elsewhere(name: str) -> dict[str, Any]:
    """Return results of a sweep's shapes in scenes other than that of their search, by "SEARCH DETECTOR".

    The columns are the counts of `transfer_table`, "lower in" in per cent. universal.json was written by hand: it has
    one search, its own names, and a share.
    """
    figures = _figures(name)
    found = {_LABEL.sub(r"\1 \2", label): one for label, one in _groups(figures).get("elsewhere", {}).items()}
    if found:
        return found
    share = figures["lower in"]
    known = {"ratio": figures["of baseline"], "lower in": share | {"value": 100 * share["value"]}}
    return {"descent pointpillars": {**figures, **known}}


_LABEL = re.compile(r"(?:shape, )?([a-z]+)[_,].* (\w+)")


def _sides() -> Mapping[str, Any]:
    """Return body types and attributes of the wide family: "seen" by trainings and "held_out"."""
    from shift3d.vehicles.family.split import SPLIT

    return SPLIT.to_dict()


def _groups(found: Mapping[str, Any], levels: int = 3) -> dict[str, Any]:
    """Group figures named TITLE/ROW/COLUMN (or ROW/COLUMN) into nested mappings, in their order."""
    nested: dict[str, Any] = {}
    for name, one in found.items():
        *outer, last = name.split("/")
        if len(outer) == levels - 1:
            functools.reduce(lambda inner, key: inner.setdefault(key, {}), outer, nested)[last] = one
    return nested
