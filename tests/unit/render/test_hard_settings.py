"""Hard contexts that depend on no single line: purpose of each preset, sunk objects, thin parts with a grid.

Contexts that do depend on one line are in the catalogue, tests/hard_cases.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from analytic_fields import SHAPENET_FRAME, Field, box, car, ground_scan, in_frame, sector_scan, sphere, union
from torch import Tensor

from shift3d.render import Beams, Rendering, RenderSettings, SdfGrid, preset, render

FAST = preset("standard").with_(dtype=torch.float64)
REFERENCE = preset("reference").with_(step_m=0.01)
PAPER = preset("paper").with_(dtype=torch.float64)
ALL = pytest.mark.parametrize("settings", [FAST, REFERENCE, PAPER], ids=["standard", "reference", "paper"])
AT_TEN = torch.tensor([10.0, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)


def one_beam(end_x: float = 30.0, start_x: float = 0.0) -> Beams:
    """Return a beam along +x."""
    return Beams.from_arrays(np.array([[end_x, 0.0, 0.0]]), np.array([start_x, 0.0, 0.0]))


def draw(beams: Beams, metric: Field, theta: Tensor = AT_TEN, settings: RenderSettings = FAST) -> Rendering:
    return render(beams, in_frame(metric, SHAPENET_FRAME), theta, SHAPENET_FRAME, settings)


def test_a_chord_shorter_than_the_papers_step_is_a_matter_of_chance_there_alone() -> None:
    # A mirror 3 cm thick, at 50 phases: the paper's 0.1 m step finds about a third, the fast march all of them.
    found = {"paper": 0, "fast": 0}
    mirror = box((0.015, 0.5, 0.5))
    for phase in np.linspace(0.0, 0.1, 50, endpoint=False):
        beam = one_beam(end_x=30.0 + float(phase) * 3.1)
        found["paper"] += draw(beam, mirror, settings=PAPER).object_points
        found["fast"] += draw(beam, mirror, settings=FAST).object_points
    assert found["fast"] == 50 and 5 < found["paper"] < 30


def test_of_three_roots_in_one_step_the_paper_takes_one_on_the_way_in() -> None:
    # Two plates 3 cm apart within one step: a bisection may return either entry, but no exit.
    plates = union(box((0.015, 0.5, 0.5), (0.0, 0.0, 0.0)), box((0.3, 0.5, 0.5), (0.345, 0.0, 0.0)))
    paper = draw(one_beam(), plates, settings=PAPER)
    assert min(abs(float(paper.range_m[0]) - x) for x in (9.985, 10.045)) < 1e-4


@ALL
def test_a_sensor_inside_the_bounding_volume_is_ordinary(settings: RenderSettings) -> None:
    rendering = draw(one_beam(start_x=8.5), sphere(1.0), settings=settings)
    assert rendering.object_points == 1 and rendering.unresolved_beams == 0
    assert float(rendering.range_m[0]) == pytest.approx(0.5, abs=1e-4)


@ALL
def test_an_object_sunk_into_the_ground_has_no_return_left_inside(settings: RenderSettings) -> None:
    beams = Beams.from_arrays(*ground_scan(rings=24, columns=240))
    theta = torch.tensor([12.0, 0.0, -1.68, 0.0, 0.0, 0.0], dtype=torch.float64)
    rendering = draw(beams, car(), theta, settings.with_(sphere_chord_only=True))
    at = rendering.points.double() - theta[:3]
    assert rendering.object_points > 20
    assert float(car()(at[rendering.hit_mask]).abs().max()) < 2e-5
    assert not (car()(at) < -2e-5).any()


@ALL
def test_no_beam_is_made_up_for_a_missing_return(settings: RenderSettings) -> None:
    points, origin = sector_scan((10.0, 0.0, 0.0), rays=8)
    points[::3] = 0.0
    rendering = draw(Beams.from_arrays(points, origin), car(), settings=settings)
    assert rendering.points.shape == points.shape and not rendering.hit_mask[::3].any()
    assert rendering.hit_mask.any() and torch.equal(rendering.points[::3], torch.zeros(len(points[::3]), 3).double())


def test_an_sdf_grid_loses_no_hit_on_thin_parts() -> None:
    thin = union(car(), box((0.02, 0.12, 0.08), (0.9, 1.0, 0.25)))
    # The baseline's box holds its mirrors: a plate this thin outside the box could escape the box's check.
    frame = replace(SHAPENET_FRAME, size_m=(4.4, 2.3, 1.5))
    field = in_frame(thin, frame)
    grid = SdfGrid.of(field, frame, FAST)
    beams = Beams.from_arrays(*sector_scan((8.0, 3.0, -1.0), half_angle_rad=0.3, rays=70))
    theta = torch.tensor([8.0, 3.0, -1.0, 0.4, 0.0, 0.0], dtype=torch.float64)
    mapped = render(beams, field, theta, frame, FAST, grid=grid)
    exact = render(beams, field, theta, frame, REFERENCE)
    assert int((mapped.hit_mask ^ exact.hit_mask).sum()) <= 1
    assert mapped.object_points > 300
