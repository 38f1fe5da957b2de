"""Counts of the script of recorded attacks: artificial losses, each under its name."""

from __future__ import annotations

from dataclasses import replace

import torch
from attack_by_hand import small_problem
from scripts.recorded_attacks import Found, figures

from shift3d.render.render import render


def test_hits_made_to_be_lost_wrong_or_false_are_counted() -> None:
    problem = small_problem()
    code, theta = problem.code0, problem.theta0
    with torch.no_grad():
        truth = render(problem.beams, problem.field_of(code), theta, problem.vehicle, problem.settings)
        hits = torch.nonzero(truth.hit_mask).squeeze(1)
        missed, behind, near = hits[len(hits) // 2], hits[len(hits) // 3], hits[len(hits) // 4]
        beside = torch.nonzero(~truth.hit_mask).squeeze(1)[0]
        mask, range_m = truth.hit_mask.clone(), truth.range_m.clone()
        mask[missed], mask[beside] = False, True
        range_m[behind] += 0.02
        range_m[near] -= 0.003
        found = Found("one")
        found.hold(problem, code, theta, truth)
        assert (found.hits, found.lost, found.false, max(found.depth_m)) == (len(hits), 0, 0, 0.0)
        found.hold(problem, code, theta, replace(truth, hit_mask=mask, range_m=range_m))
    assert (found.hits, found.lost, found.lost_thick, found.false) == (2 * len(hits), 2, 2, 1)
    assert abs(max(found.depth_m) - 0.003) < 1e-12 and len(found.depth_m) == 2 * len(hits) - 2


def test_together_is_the_sum_and_the_least_cosine() -> None:
    parts = [
        Found("a", 10, 1, 0, 2, (0.001,), (0.9, 1.0), (0.99, 1.0)),
        Found("b", 20, 3, 1, 0, (0.002,), (0.8,), (1.0,)),
    ]
    named = figures(parts, "of a decoder: ")
    assert len(named) == 3 * 8 and named["of a decoder: a/least cosine"]["value"] == 0.9
    together = {name.split("/")[1]: one["value"] for name, one in named.items() if "together" in name}
    assert [together[what] for what in ("hits", "lost", "lost of 2 cm", "false")] == [30, 4, 1, 2]
    assert (together["depth max"], together["least cosine"]) == (2.0, 0.8)
    assert together["least cosine of the renderer"] == 0.99
