"""Section and page of the measured impact of effects, for sweeps that ran with and without them."""

from __future__ import annotations

from collections.abc import Sequence

from shift3d.analysis.figures.picture import png
from shift3d.analysis.figures.sweep import effects_figure
from shift3d.analysis.html.blocks import Block, Collapsible, Paragraph, Picture, Section, Terms, missing
from shift3d.analysis.html.document import document, write_page
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.effects import MEANINGS, EffectImpact, effect_impacts, effect_milliseconds, effect_table
from shift3d.analysis.tables.table import number
from shift3d.errors import InputError
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike


def effects(sweep: Sweep) -> list[Block]:
    """Build the section, or one line if the sweep has no pairs with and without one effect."""
    try:
        impacts = effect_impacts(sweep.scores, effect_milliseconds(sweep.scores, sweep.timings))
    except InputError as error:
        return [missing(f"Not measured by this sweep: {error.what}. {error.remedy}.")]
    return _blocks(impacts)


def write_effects_page(path: LocationLike, sweep: str, impacts: Sequence[EffectImpact]) -> Location:
    """Write the page of the effects' impact atomically. Returns its path."""
    section = Section("effects", "Impact and time", _blocks(impacts))
    return write_page(path, document(f"Measured impact of effects: {sweep}", [section]))


def _blocks(impacts: Sequence[EffectImpact]) -> list[Block]:
    """Build figure, table and meanings of the columns."""
    each = [(impact.effect, impact.score_change.mean, number(impact.milliseconds, 0)) for impact in impacts]
    alt = "; ".join(f"{effect}: {change:.3f} for {spent} ms" for effect, change, spent in each)
    return [
        Paragraph("The same vehicles at the same places, rendered without effects and with one effect at a time."),
        Picture(
            png(effects_figure({impact.effect: impact.measured for impact in impacts})),
            alt,
            "effects=auto leaves out an effect whose whole bar is below the dashed line.",
        ),
        effect_table(impacts),
        Collapsible("What the columns mean", [Terms(MEANINGS)]),
    ]
