"""Bird's-eye-view grids of the score's fall around the ego vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from shift3d.analysis.html.blocks import Block, Collapsible, Panels, Paragraph, Plot, missing
from shift3d.analysis.html.figure import axis, marks, plot
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.sensors import transfer_table
from shift3d.analysis.tables.table import Table
from shift3d.analysis.variants import Variant
from shift3d.store.schemas import GROUP_COLUMNS

_SHOWN = 2  # number of grids that are not folded
_SIDES_M = {"x0": -2.4, "x1": 2.4, "y0": -1.0, "y1": 1.0}
# Rectangle of the ego vehicle around the sensor, with the size of a common car.
_EGO = {"type": "rect", **_SIDES_M, "line": {"color": "#2f8fc9", "width": 2}, "fillcolor": "#2f8fc9"}
_LEAD = (
    "Mean score reduction (baseline minus adversarial) over all vehicles, by position of the baseline. The sensor "
    "frame is seen from above; x points forward, to the right of the picture. A cross marks a cell without a "
    "placement. The rectangle is the ego vehicle."
)
_TRANSFER_LEAD = (
    "Each adversarial shape was put into other scenes of the set at a random place and heading, and its baseline at "
    "the same place and heading. The grid shows the mean score reduction by cell."
)


def bev(sweep: Sweep, found: Sequence[Variant]) -> list[Block]:
    """Build the section with one grid per variant, later ones folded."""
    nothing = "No adversarial vehicle has a score, so there is no grid."
    return _grids(sweep.bev, found, "bev", _LEAD, nothing)


def transfer_grid(sweep: Sweep, found: Sequence[Variant]) -> list[Block]:
    """Build the section about shapes in scenes and at places other than those of their search."""
    nothing = "This sweep put no shape into another scene."
    table = transfer_table(sweep.transfers)
    return [*_grids(sweep.bev_transfer, found, "transfer", _TRANSFER_LEAD, nothing), *([table] if table else [])]


def _grids(grid: pd.DataFrame, found: Sequence[Variant], key: str, lead: str, nothing: str) -> list[Block]:
    grids = [(variant, cells) for variant in found if len(cells := pooled_cells(grid, variant))]
    if not grids:
        return [missing(nothing)]
    drawn = [_plot(variant, cells, key) for variant, cells in grids]
    folds = [
        Collapsible(f"Grid: {variant.label}", [part]) for (variant, _), part in zip(grids[_SHOWN:], drawn[_SHOWN:])
    ]
    tables = Collapsible("Grids as tables", [_table(variant, cells) for variant, cells in grids])
    return [Paragraph(lead), Panels(drawn[:_SHOWN], "wide"), *folds, tables]


def pooled_cells(grid: pd.DataFrame, variant: Variant) -> pd.DataFrame:
    """Average cells over vehicles by scores: cell_x_m, cell_y_m, cell_size_m, scores, mean_reduction."""
    rows = grid[(grid["method"] == "adversarial") & (grid["scores"] > 0)]
    chosen = variant.auc[variant.auc["method"] == "adversarial"][list(GROUP_COLUMNS)].drop_duplicates()
    if rows.empty or chosen.empty:  # columns of empty frames have no types to merge on
        return rows.iloc[:0]
    rows = rows.merge(chosen, on=list(GROUP_COLUMNS), how="inner")
    rows = rows.assign(weighted=rows["mean_reduction"] * rows["scores"])
    summed = rows.groupby(["cell_x_m", "cell_y_m", "cell_size_m"], as_index=False)[["scores", "weighted"]].sum()
    return summed.assign(mean_reduction=summed["weighted"] / summed["scores"]).drop(columns="weighted")


def _plot(variant: Variant, cells: pd.DataFrame, key: str) -> Plot:
    size = float(cells["cell_size_m"].iloc[0])
    reach = float(np.abs(cells[["cell_x_m", "cell_y_m"]].to_numpy()).max()) + size
    sides = {"range": [-reach, reach], "constrain": "domain", "dtick": 2 * size}
    layout = {
        "xaxis": axis("x, forward, m", **sides),
        "yaxis": axis("y, left, m", **sides, scaleanchor="x"),
        "shapes": [_EGO],
    }
    fallen = int((cells["mean_reduction"] > 0).sum())
    share = f"{fallen / len(cells):.0%}"
    text = f"the score falls in {fallen} of {len(cells)} cells of {size:g} m that hold a vehicle ({share})"
    caption = f"{variant.title}: {text}"
    traces = _heat(cells, size, reach)
    return plot(f"{key}-{variant.key}", traces, layout, f"Bird's-eye-view grid. {caption}", caption, height_px=500)


def _heat(cells: pd.DataFrame, size: float, reach: float) -> list[dict[str, Any]]:
    """Create a heat map of the cells' reduction, with crosses at empty cells."""
    count = round(2 * reach / size)
    values, texts = np.full((count, count), np.nan), np.full((count, count), "", dtype=object)
    for cell in cells.itertuples():
        column, row = round((cell.cell_x_m + reach) / size), round((cell.cell_y_m + reach) / size)
        values[row, column] = round(cell.mean_reduction, 4)
        texts[row, column] = f"{cell.mean_reduction:+.2f}"
    centres = -reach + size * (np.arange(count) + 0.5)
    heat = {
        **{"type": "heatmap", "x": centres, "y": centres, "z": values, "xgap": 1, "ygap": 1},
        **{"text": texts.tolist(), "texttemplate": "%{text}", "hoverongaps": False},
        # Fixed ends make grids of different sweeps comparable by eye.
        **{"zmin": -1, "zmax": 1, "colorscale": [[0, "#2166ac"], [0.5, "#e8e8e8"], [1, "#b2182b"]]},
        "colorbar": {
            **{"orientation": "h", "thickness": 12, "y": -0.16, "yanchor": "top"},
            "title": {"text": "mean score reduction", "side": "bottom"},
        },
        "hovertemplate": "x %{x:.0f} m, y %{y:.0f} m: %{z:+.3f}<extra></extra>",
    }
    empty_y, empty_x = np.nonzero(np.isnan(values))
    marker = {"symbol": "x-thin", "size": 7, "line": {"width": 1.5, "color": "#8a8a8a"}}
    hover = "x %{x:.0f} m, y %{y:.0f} m: no placement<extra></extra>"
    return [heat, marks(centres[empty_x], centres[empty_y], marker, hovertemplate=hover, showlegend=False)]


def _table(variant: Variant, cells: pd.DataFrame) -> Table:
    lines = [
        [
            f"{cell.cell_x_m:g} to {cell.cell_x_m + cell.cell_size_m:g}",
            f"{cell.cell_y_m:g} to {cell.cell_y_m + cell.cell_size_m:g}",
            str(int(cell.scores)),
            f"{cell.mean_reduction:+.3f}",
        ]
        for cell in cells.itertuples()
    ]
    return Table(f"Reduction by cell, {variant.label}", ["x, m", "y, m", "scores", "mean reduction"], lines)
