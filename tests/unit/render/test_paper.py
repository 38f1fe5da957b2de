"""The fast renderer against its plain reference, on an analytic car and on a decoder as published."""

import copy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from analytic_fields import SHAPENET_FRAME, Frame, car, ground_scan, in_frame, sector_scan

from shift3d.render import Beams, Field, Rendering, preset, render

THETA = torch.tensor([11.0, -6.0, -0.98, 2.1, 0.0, 0.0], dtype=torch.float64)


def agree(fast: Rendering, plain: Rendering, limb_share: float, depth_p99_m: float) -> None:
    """Check agreement. The paper's 0.1 m step misses chords shorter than itself, so it may only have fewer hits."""
    hits = int(plain.hit_mask.sum())
    assert hits > 100
    assert int((plain.hit_mask & ~fast.hit_mask).sum()) == 0
    assert int((fast.hit_mask & ~plain.hit_mask).sum()) <= limb_share * hits
    both = plain.hit_mask & fast.hit_mask
    depth = (plain.range_m - fast.range_m)[both].abs()
    other_surface = depth > 0.02
    # Where they differ, the finer search has the nearer surface.
    assert (fast.range_m <= plain.range_m + 1e-3)[both].all()
    assert float(other_surface.double().mean()) <= limb_share
    assert float(depth[~other_surface].quantile(0.99)) < depth_p99_m


def test_on_an_analytic_car() -> None:
    beams = Beams.from_arrays(*ground_scan(rings=64, columns=1024))
    field = in_frame(car(), SHAPENET_FRAME)
    plain = render(beams, field, THETA, SHAPENET_FRAME, preset("paper").with_(dtype=torch.float64))
    chord = render(
        beams, field, THETA, SHAPENET_FRAME, preset("paper").with_(dtype=torch.float64, sphere_chord_only=True)
    )
    fast = render(beams, field, THETA, SHAPENET_FRAME, preset("standard"))
    agree(fast, plain, 0.02, 1e-4)
    assert torch.equal(plain.points, chord.points)
    assert fast.evaluations * 20 < chord.evaluations < plain.evaluations


def test_a_beam_without_a_return_is_marched_no_farther_than_the_sphere() -> None:
    """The beam has the same hit as a beam that ends just behind the object."""
    field, settings = in_frame(car(), SHAPENET_FRAME), preset("paper").with_(dtype=torch.float64)
    near, far = (
        render(Beams.from_arrays(*sector_scan(tuple(THETA[:3]), far_m=far_m)), field, THETA, SHAPENET_FRAME, settings)
        for far_m in (25.0, 1e4)
    )
    both = near.hit_mask & far.hit_mask
    assert int(both.sum()) > 100 and int((near.hit_mask ^ far.hit_mask).sum()) <= 0.02 * int(both.sum())
    assert float((near.range_m - far.range_m)[both].abs().quantile(0.9)) < 1e-6
    assert far.evaluations <= near.evaluations


def test_what_a_draft_leaves_out() -> None:
    """A draft misses chords shorter than its step, and the last millimetres of depth."""
    beams = Beams.from_arrays(*ground_scan(rings=64, columns=1024))
    field = in_frame(car(), SHAPENET_FRAME)
    fine, draft = (render(beams, field, THETA, SHAPENET_FRAME, preset(name)) for name in ("standard", "draft"))
    assert draft.evaluations < 0.9 * fine.evaluations
    assert not (draft.hit_mask & ~fine.hit_mask).any()
    lost, hits = int((fine.hit_mask & ~draft.hit_mask).sum()), int(fine.hit_mask.sum())
    assert lost <= 0.01 * hits
    both = draft.hit_mask & fine.hit_mask
    assert float((draft.range_m - fine.range_m)[both].abs().quantile(0.95)) < 0.01


@pytest.fixture
def published(real_data: Callable[[str], Path]) -> tuple[Field, Field, Frame]:
    """A trained 8 x 512 decoder with one of its cars: float32, float64, frame."""
    from shift3d.sdf.deepsdf_checkpoint import load_deepsdf_checkpoint

    experiment = load_deepsdf_checkpoint(real_data("decoder"))
    decoder, codes = experiment.decoder, experiment.codes
    code = codes[45]
    axes = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    frame = Frame((4.6, 1.9, 1.45), 2.43, axes, np.zeros(3))
    counterpart = copy.deepcopy(decoder).double()
    return decoder.field(code), counterpart.field(code.double()), frame


def test_on_a_published_decoder(published: tuple[Field, Field, Frame]) -> None:
    field32, field64, frame = published
    x, y, z = THETA[:3].tolist()
    beams = Beams.from_arrays(*sector_scan((x, y, z), half_angle_rad=0.17, rays=20, dtype=np.float32))
    with torch.no_grad():
        fast = render(beams, field32, THETA, frame, preset("standard"))
        exact = render(beams, field64, THETA, frame, preset("reference").with_(step_m=0.02, max_step_m=0.1))
        plain = render(beams, field32, THETA, frame, preset("paper").with_(sphere_chord_only=True))
    agree(fast, plain, 0.03, 3e-4)
    both = exact.hit_mask & fast.hit_mask
    assert int((exact.hit_mask ^ fast.hit_mask).sum()) <= 1
    depth = (exact.range_m - fast.range_m)[both].abs()
    assert float(depth.quantile(0.98)) < 3e-4
    assert fast.evaluations < 12_000
