"""A survey of places states for each place if a car fits there, and if not, the reason."""

from __future__ import annotations

from collections import Counter

import numpy as np
import torch
from analytic_fields import ground_scan
from hills import slope_scan

from shift3d.placement.constraints import Constraints
from shift3d.placement.sampling import REFUSALS, PlacementContext, PlacementLimits, pose_on_ground
from shift3d.placement.survey import CAR_SIZE_M, Survey, survey
from shift3d.render import Beams
from shift3d.scenes.sets import StreetScenes
from shift3d.task.places import NO_GROUND, place_lines
from shift3d.task.spec import PlacementSpec

LIMITS = PlacementLimits(9.0, 12.0, sector=(0.0, 0.4), attempts=25)


def tried(points: np.ndarray, others: torch.Tensor | None = None, fewest: int = 150) -> Survey:
    beams, rules = Beams.from_arrays(points.astype(np.float32), np.zeros(3)), Constraints(min_object_points=fewest)
    return survey(PlacementContext(beams, -1.73, others), LIMITS, rules)


def counts(found: Survey) -> dict[str, int]:
    return dict(Counter(found.outcomes))


def plain() -> np.ndarray:
    return ground_scan(rings=64, columns=900)[0]


def fenced() -> np.ndarray:
    """Return fifteen beams: fourteen end at a fence 5 m ahead, one passes through."""
    points = plain()
    blocked = (np.arange(len(points)) % 15 != 0) & (points[:, 0] > 5.0)
    points[blocked] *= 5.0 / points[blocked, :1]
    return points


def test_each_reason_is_found_where_it_holds() -> None:
    assert counts(tried(plain())) == {"free": 25}
    assert counts(tried(fenced())) == {"hidden": 25}
    assert counts(tried(slope_scan(0.12, 0.0))) == {"slope": 25}
    assert counts(tried(plain()[plain()[:, 2] > -1.7])) == {"ground": 25}
    assert counts(tried(plain(), fewest=9000)) == {"points": 25}
    post = np.column_stack((np.full(400, 10.5), np.zeros(400), np.linspace(-1.7, 1.0, 400)))
    assert "occupied" in counts(tried(np.vstack((plain(), post))))
    neighbour = torch.tensor([[10.5, 0.0]], dtype=torch.float64)
    assert counts(tried(plain(), others=neighbour)) == {"neighbour": 25}


def test_a_neighbour_at_exactly_the_limit_is_too_near_though_float32_puts_it_farther() -> None:
    beams, size, rules = Beams.from_arrays(plain(), np.zeros(3)), torch.tensor(CAR_SIZE_M), Constraints(clear_m=6.0)
    x = 20.3
    assert float(np.float32(x)) < x and x + rules.clear_m - x == rules.clear_m
    site = PlacementContext(beams, -1.73, torch.tensor([[x + rules.clear_m, 0.0]], dtype=torch.float64))
    assert pose_on_ground((x, 0.0, 0.3), site, size, rules) == "neighbour"


def test_no_vehicle_stands_where_the_data_set_labels_nothing() -> None:
    beams, rules = Beams.from_arrays(plain().astype(np.float32), np.zeros(3)), Constraints(min_object_points=150)
    everywhere, elsewhere = plain()[:, :2], plain()[plain()[:, 0] < 0.0, :2]
    assert counts(survey(PlacementContext(beams, -1.73, unlabelled=everywhere), LIMITS, rules)) == {"unlabelled": 25}
    assert counts(survey(PlacementContext(beams, -1.73, unlabelled=elsewhere), LIMITS, rules)) == {"free": 25}


def test_a_survey_is_repeated_and_counted_in_words() -> None:
    post = np.column_stack((np.full(400, 10.5), np.zeros(400), np.linspace(-1.7, 1.0, 400)))
    points = np.vstack((plain(), post))
    found, again = tried(points), tried(points)
    assert found.outcomes == again.outcomes and np.array_equal(found.xy_m, again.xy_m)
    free = int(found.free.sum())
    assert 0 < free < 25
    assert found.line() == f"{free} of 25 free; {REFUSALS['occupied']} {25 - free}"
    reach = np.hypot(*found.xy_m.T)
    assert ((reach >= 9.0) & (reach <= 12.0)).all()


def test_a_scene_in_which_no_ground_is_seen_says_what_to_do() -> None:
    assert tried(plain()[plain()[:, 2] > -1.7]).lacks_ground and not tried(plain()).lacks_ground
    streets = StreetScenes("hdl64", seed=3)
    near, far = (
        list(place_lines(streets, streets.names()[:1], PlacementSpec(min_range_m=low, max_range_m=high, attempts=20)))
        for low, high in ((15.0, 30.0), (300.0, 320.0))
    )
    assert len(near) == 1 and "no ground seen 20" in far[0]
    assert far[1].strip() == NO_GROUND and "attack.placement.max_range_m" in NO_GROUND
