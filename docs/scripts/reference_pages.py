"""Writes docs/reference: settings, tables and commands, from the code and the configuration.

``python docs/scripts/reference_pages.py`` writes the pages; a test fails if the stored pages differ from its output.
"""

from __future__ import annotations

import argparse
import inspect
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa

from shift3d.cli.main import COMMANDS, make_parser
from shift3d.exit_codes import EXIT_CODES
from shift3d.render.settings import PRESETS, RenderSettings
from shift3d.store.schemas import AGGREGATES, COLUMN_MEANINGS, SCHEMA_VERSION, SCHEMAS, SEGMENTS, TABLE_DESCRIPTIONS

DOCS = Path(__file__).resolve().parents[1]
CONF = DOCS.parent / "conf"
SWEEPS = DOCS.parent / "sweeps"
FOLDER = DOCS / "reference"
MADE = "<!-- Made by docs/scripts/reference_pages.py (make docs); edit what it reads. -->\n\n"
GROUPS = {
    "scenes": "Where the vehicle is put.",
    "vehicle": "Which vehicle.",
    "detector": "Which detector is attacked, and which others score.",
    "attack": "The search, its comparisons, and where a vehicle may be placed.",
    "accuracy": "How exact the renderer and the detector are. `null` stands for the preset's value.",
    "effects": "Which effects of the sensor and the weather are simulated.",
    "naturalness": "What shapes are compared with: see [naturalness](../why/naturalness.md).",
    "runner": "Where tasks run. No setting here changes a result.",
    "tracking": "Where results are mirrored.",
    "size": "How large a sweep is.",
}
_SETTING = re.compile(r"^(?P<indent> *)(?P<key>[\w]+):(?: (?P<value>[^#]*?))?(?: *# (?P<meaning>.*))?$")


def pages() -> dict[Path, str]:
    """Return every page and its content."""
    return {
        FOLDER / "settings.md": MADE + settings_page(),
        FOLDER / "tables.md": MADE + tables_page(),
        FOLDER / "commands.md": MADE + commands_page(),
    }


def settings_page() -> str:
    """Return the page of all settings in conf/, group by group."""
    lines = [
        "# Settings",
        "",
        "A sweep file in `sweeps/` names options of these groups and values of these settings; the command line",
        'overrides them: `make sweep ARGS="detector=sst attack.steps=80"`. Several values are an axis:',
        "`vehicle=coupe,suv`. `???` has to be given.",
        "",
        "## Every task",
        "",
        *_table(list(_settings(CONF / "config.yaml")), ""),
    ]
    for group, about in GROUPS.items():
        lines += ["", f"## {group}", "", about]
        if group in ("effects", "size"):
            lines += ["", "| option | meaning |", "|---|---|"]
            lines += [f"| `{group}={file.stem}` | {_cell(' '.join(_lead(file)))} |" for file in _options(group)]
        else:
            for file in _options(group):
                lines += ["", f"### {group}={file.stem}", "", *_lead(file), ""]
                lines += _table(list(_settings(file)), f"{group}.")
        if group == "accuracy":
            lines += ["", "### accuracy.render", "", *_render_table()]
        if group == "effects":
            stated = CONF / "effects/_settings.yaml"
            lines += [
                "",
                "### Statements about scenes",
                "",
                *_lead(stated),
                "",
                *_table(list(_settings(stated)), "effects."),
            ]
    lines += ["", "## Sweeps", "", "| `make sweep SWEEP=` | what it measures |", "|---|---|"]
    lines += [f"| `{file.stem}` | {' '.join(_lead(file))} |" for file in sorted(SWEEPS.glob("*.yaml"))]
    return "\n".join(lines) + "\n"


def _options(group: str) -> list[Path]:
    files = sorted(file for file in (CONF / group).glob("*.yaml") if not file.stem.startswith("_"))
    if group != "vehicle":
        return files
    # The shipped vehicles differ in their name alone: the page shows the first one.
    shipped = [file for file in files if "kind: set" in file.read_text() and file.stem != "set"]
    return [file for file in files if file not in shipped[1:]]


def _lead(file: Path) -> list[str]:
    """Return the comment at the head of a file."""
    found = []
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        if not line.startswith("# @package"):
            found.append(line.removeprefix("#").strip())
    return found


def _settings(file: Path) -> Iterator[tuple[str, str, str]]:
    """Yield (name, value, meaning) of each setting of a file; comment lines above a setting precede its own comment."""
    path: list[str] = []
    above: list[str] = []
    text = file.read_text(encoding="utf-8").splitlines()[len(_lead(file)) :]
    for line in text:
        if line.startswith("#"):
            above.append(line.removeprefix("#").strip())
            continue
        match = _SETTING.match(line)
        if match is None or not match["key"]:
            continue
        if match["key"] == "defaults" and not match["indent"]:
            continue
        path = [*path[: len(match["indent"]) // 2], match["key"]]
        value = (match["value"] or "").strip()
        meaning = " ".join([*above, match["meaning"] or ""]).strip()
        above = []
        if value or match["meaning"]:
            yield ".".join(path), value, meaning


def _table(rows: list[tuple[str, str, str]], prefix: str) -> list[str]:
    cells = [
        f"| `{prefix}{name}` | {f'`{value}`' if value else ''} | {_cell(meaning)} |" for name, value, meaning in rows
    ]
    return ["| setting | value | meaning |", "|---|---|---|", *cells]


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _render_table() -> list[str]:
    """Return the renderer's settings: meanings from their docstring, values from each preset."""
    meanings = render_meanings()
    head = ["| `accuracy.render.` | " + " | ".join(f"`{name}`" for name in PRESETS) + " | meaning |"]
    head.append("|---" * (len(PRESETS) + 2) + "|")
    for name in RenderSettings.__dataclass_fields__:
        values = (str(getattr(preset, name)).removeprefix("torch.") for preset in PRESETS.values())
        head.append(f"| `{name}` | {' | '.join(values)} | {_cell(meanings[name])} |")
    return head


def render_meanings() -> dict[str, str]:
    """Return the paragraphs of `RenderSettings`'s docstring, by setting."""
    text = inspect.getdoc(RenderSettings) or ""
    found: dict[str, str] = {}
    for part in re.split(r"\n    (?=[a-z_0-9, ]+: )", text.partition("Attributes:")[2]):
        names, _, meaning = part.strip().partition(": ")
        for name in names.split(", "):
            found[name] = " ".join(meaning.split())
    return found


def tables_page() -> str:
    """Return the page of all tables in a sweep's folder, column by column."""
    lines = [
        "# Tables",
        "",
        f"Parquet files of schema version {SCHEMA_VERSION} in `OUT/final/`. pandas, polars and duckdb read",
        "them as they are; polars and duckdb are the extra `.[tables]` ([how](../guides/report.md#the-tables)).",
        "Folders of older versions are read by every command.",
    ]
    for name in (*SEGMENTS, *AGGREGATES):
        lines += [
            "",
            f"## {name}.parquet",
            "",
            f"{TABLE_DESCRIPTIONS[name][0].upper()}{TABLE_DESCRIPTIONS[name][1:]}.",
            "",
        ]
        lines += ["| column | type | null | meaning |", "|---|---|---|---|"]
        for field in SCHEMAS[name]:
            null = "yes" if field.nullable else ""
            lines.append(f"| `{field.name}` | {_type(field.type)} | {null} | {_cell(COLUMN_MEANINGS[field.name])} |")
    return "\n".join(lines) + "\n"


def _type(kind: pa.DataType) -> str:
    if pa.types.is_list(kind):
        return f"list of {_type(kind.value_type)}"
    return {"double": "float64", "float": "float32"}.get(str(kind), str(kind))


def commands_page() -> str:
    """Return the page of all commands with their help, and the exit codes."""
    lines = ["# Commands", "", "`make help` lists the targets of the Makefile, which call these.", ""]
    lines += ["| command | what it does |", "|---|---|"]
    lines += [f"| [`shift3d {c.name}`](#shift3d-{c.name}) | {_cell(c.summary)} |" for c in COMMANDS]
    lines += ["", "## Exit codes", "", "| code | meaning |", "|---|---|"]
    lines += [f"| {int(code)} | {meaning} |" for code, meaning in EXIT_CODES.items()]
    lines.append("\n`make` itself ends with 2 where a command ends with another code than 0.")
    os.environ["COLUMNS"] = "110"  # the width to which argparse wraps
    parsers = _parsers(make_parser())
    for command in COMMANDS:
        lines += ["", f"## shift3d {command.name}", "", "```text", parsers[command.name].format_help().rstrip(), "```"]
    return "\n".join(lines) + "\n"


def _parsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    actions = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return dict(actions[0].choices)


def main() -> int:
    """Write the pages."""
    FOLDER.mkdir(exist_ok=True)
    for path, content in pages().items():
        path.write_text(content, encoding="utf-8")
        print(path.relative_to(DOCS.parent))
    return 0


if __name__ == "__main__":
    sys.exit(main())
