"""Where the score falls: a bird's-eye-view grid around the ego vehicle."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from shift3d.analysis.html.document import Section, aside, paragraph, table
from shift3d.analysis.html.figure import axis, figure_html
from shift3d.analysis.results import Sweep, Variant
from shift3d.store.schemas import GROUP_COLUMNS

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["EGO_M", "bev", "pooled_cells", "transfer_grid"]

_OPEN = 2  # grids in sight; the others fold
EGO_M = (4.8, 2.0)
"""Length and width of the ego vehicle as it is drawn around the sensor, metres: a usual car's."""


def bev(sweep: Sweep, found: list[Variant]) -> Section:
    """The section: a grid a variant, the later ones folded."""
    body = [
        paragraph(
            "Mean reduction of the score, baseline minus adversarial, over all vehicles, by where the baseline stood. "
            "Sensor frame seen from above: x forward, to the right of the picture. Cells with a cross had no "
            "placement. The rectangle is the ego vehicle."
        )
    ]
    grids = [(variant, cells) for variant in found if len(cells := pooled_cells(sweep.bev, variant))]
    drawn = [f"<div>{_figure(variant, cells)}{_table(variant, cells)}</div>" for variant, cells in grids]
    body.append(f'<div class="panels wide">{"".join(drawn[:_OPEN])}</div>')
    body += [aside(f"Grid: {variant.label}", [part]) for (variant, _), part in zip(grids[_OPEN:], drawn[_OPEN:])]
    if not grids:
        body = [paragraph("No adversarial vehicle was scored: there is no grid.", "missing")]
    return Section("bev", "Where the score falls", body)


def transfer_grid(sweep: Sweep, found: list[Variant]) -> Section:
    """The section: what shapes do in scenes and at places that they were not made for."""
    grids = [(variant, cells) for variant in found if len(cells := pooled_cells(sweep.bev_transfer, variant))]
    title = "In other scenes, at other places"
    if not grids:
        return Section("transfer", title, [paragraph("No shape was put into another scene by this sweep.", "missing")])
    body = [
        paragraph(
            "Each adversarial shape in other scenes of the set, at a random place and heading, and its baseline at the "
            "same ones: mean reduction of the score by the cell that it was put into. As above: cells with a cross had "
            "no placement, the rectangle is the ego vehicle."
        )
    ]
    drawn = [f"<div>{_figure(variant, cells, 'transfer')}{_table(variant, cells)}</div>" for variant, cells in grids]
    body.append(f'<div class="panels wide">{"".join(drawn[:_OPEN])}</div>')
    body += [aside(f"Grid: {variant.label}", [part]) for (variant, _), part in zip(grids[_OPEN:], drawn[_OPEN:])]
    return Section("transfer", title, body)


def pooled_cells(grid: pd.DataFrame, variant: Variant) -> pd.DataFrame:
    """Cells (cell_x_m, cell_y_m, cell_size_m, scores, mean_reduction) of a variant, vehicles pooled by their scores."""
    rows = grid[(grid["method"] == "adversarial") & (grid["scores"] > 0)]
    chosen = variant.rows[variant.rows["method"] == "adversarial"][list(GROUP_COLUMNS)].drop_duplicates()
    rows = rows.merge(chosen, on=list(GROUP_COLUMNS), how="inner")
    rows = rows.assign(weighted=rows["mean_reduction"] * rows["scores"])
    summed = rows.groupby(["cell_x_m", "cell_y_m", "cell_size_m"], as_index=False)[["scores", "weighted"]].sum()
    return summed.assign(mean_reduction=summed["weighted"] / summed["scores"]).drop(columns="weighted")


def _figure(variant: Variant, cells: pd.DataFrame, key: str = "bev") -> str:
    size = float(cells["cell_size_m"].iloc[0])
    reach = float(np.abs(cells[["cell_x_m", "cell_y_m"]].to_numpy()).max()) + size
    count = round(2 * reach / size)
    values, texts = np.full((count, count), np.nan), np.full((count, count), "", dtype=object)
    for cell in cells.itertuples():
        column, row = round((cell.cell_x_m + reach) / size), round((cell.cell_y_m + reach) / size)
        values[row, column] = round(cell.mean_reduction, 4)
        texts[row, column] = f"{cell.mean_reduction:+.2f}"
    centres = -reach + size * (np.arange(count) + 0.5)
    heat = {
        "type": "heatmap",
        "x": centres,
        "y": centres,
        "z": values,
        "text": texts.tolist(),
        "texttemplate": "%{text}",
        # Fixed ends, so that grids of different sweeps can be compared by eye.
        "zmin": -1,
        "zmax": 1,
        "colorscale": [[0, "#2166ac"], [0.5, "#e8e8e8"], [1, "#b2182b"]],
        "colorbar": {"orientation": "h", "thickness": 12, "y": -0.16, "yanchor": "top"},
        "xgap": 1,
        "ygap": 1,
        "hoverongaps": False,
        "hovertemplate": "x %{x:.0f} m, y %{y:.0f} m: %{z:+.3f}<extra></extra>",
    }
    empty_y, empty_x = np.nonzero(np.isnan(values))
    empty = {
        "type": "scatter",
        "mode": "markers",
        "x": centres[empty_x],
        "y": centres[empty_y],
        "marker": {"symbol": "x-thin", "size": 7, "line": {"width": 1.5, "color": "#8a8a8a"}},
        "hovertemplate": "x %{x:.0f} m, y %{y:.0f} m: no placement<extra></extra>",
        "showlegend": False,
    }
    layout = {
        "xaxis": axis("x, forward, m", range=[-reach, reach], constrain="domain", dtick=2 * size),
        "yaxis": axis("y, left, m", range=[-reach, reach], scaleanchor="x", constrain="domain", dtick=2 * size),
        "shapes": [_ego()],
    }
    fallen = int((cells["mean_reduction"] > 0).sum())
    share = f"{fallen / len(cells):.0%}"
    text = f"The score falls in {fallen} of {len(cells)} cells of {size:g} m that hold a vehicle ({share})."
    caption = f"{variant.label[0].upper()}{variant.label[1:]}. {text}"
    return figure_html(
        f"{key}-{variant.key}", [heat, empty], layout, f"Bird's-eye-view grid. {caption}", caption, height_px=500
    )


def _ego() -> dict[str, Any]:
    length, width = EGO_M
    sides = {"x0": -length / 2, "x1": length / 2, "y0": -width / 2, "y1": width / 2}
    return {"type": "rect", **sides, "line": {"color": "#2f8fc9", "width": 2}, "fillcolor": "#2f8fc9"}


def _table(variant: Variant, cells: pd.DataFrame) -> str:
    lines = [
        [
            f"{cell.cell_x_m:g} to {cell.cell_x_m + cell.cell_size_m:g}",
            f"{cell.cell_y_m:g} to {cell.cell_y_m + cell.cell_size_m:g}",
            str(int(cell.scores)),
            f"{cell.mean_reduction:+.3f}",
        ]
        for cell in cells.itertuples()
    ]
    header = ["x, m", "y, m", "scores", "mean reduction"]
    return aside("The same as a table", [table(f"Reduction by cell, {variant.label}", header, lines)])
