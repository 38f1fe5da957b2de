"""Space of a shape search: subspaces of codes, and the limits that keep a search in them."""

import numpy as np
import pytest
import torch

from shift3d.attack.space import free_space, parameter_space, pca_space
from shift3d.errors import InputError
from shift3d.sdf.principal_components import ball_radius
from shift3d.vehicles.parameter_box import ParameterBox

AXES = np.linalg.qr(np.random.default_rng(0).standard_normal((8, 3)))[0].T
SPREAD = np.array([3.0, 1.0, 0.5])


@pytest.fixture(scope="module")
def codes() -> np.ndarray:
    """4,000 codes in a 3D plane through (1, ..., 1), with known standard deviations."""
    rng = np.random.default_rng(1)
    return (1.0 + (rng.standard_normal((4000, 3)) * SPREAD) @ AXES).astype(np.float32)


def test_the_free_space_is_the_code_itself() -> None:
    code0 = torch.arange(5.0)
    space = free_space(code0)
    assert torch.equal(space.code(code0), code0) and torch.equal(space.project(1e9 * code0), 1e9 * code0)
    drawn = space.draw(np.random.default_rng(0), 0.3)
    assert float((drawn - code0).norm()) == pytest.approx(0.3, rel=1e-5)


def test_nineteen_of_twenty_gaussian_draws_lie_in_the_ball() -> None:
    assert ball_radius(1) == pytest.approx(1.959964, abs=1e-6)
    assert ball_radius(2) == pytest.approx(np.sqrt(-2.0 * np.log(0.05)), rel=1e-12)
    lengths = np.linalg.norm(np.random.default_rng(0).standard_normal((20_000, 10)), axis=1)
    assert (lengths <= ball_radius(10)).mean() == pytest.approx(0.95, abs=0.005)


def test_coordinates_of_pca_are_standard_deviations_from_the_mean(codes: np.ndarray) -> None:
    code0 = torch.from_numpy(codes.mean(axis=0)).double()
    space = pca_space(code0, codes, 3, "codes")
    assert space.start.abs().max() < 1e-5
    moved = space.code(torch.tensor([2.0, 0.0, 0.0], dtype=torch.float64)) - code0
    assert float(moved.norm()) == pytest.approx(2 * 3.0, rel=0.03)
    assert abs(float(moved @ torch.from_numpy(AXES[0]))) == pytest.approx(float(moved.norm()), rel=1e-3)


def test_pca_starts_at_the_baseline_whatever_its_code_has_beside_the_plane(codes: np.ndarray) -> None:
    beside = np.linalg.svd(AXES)[2][-1]  # orthogonal to all three axes
    code0 = torch.from_numpy(codes[7] + 5.0 * beside.astype(np.float32))
    space = pca_space(code0, codes, 3, "codes")
    assert torch.allclose(space.code(space.start), code0)
    end = space.code(space.project(space.start + 1.0))
    assert float((end - code0).double() @ torch.from_numpy(beside)) == pytest.approx(0.0, abs=1e-4)


def test_the_ball_of_pca_holds_95_of_100_draws_of_a_gaussian(codes: np.ndarray) -> None:
    space = pca_space(torch.from_numpy(codes.mean(axis=0)), codes, 3, "codes")
    draws = torch.from_numpy(np.random.default_rng(2).standard_normal((4000, 3)))
    kept = [torch.equal(space.project(u), u) for u in draws]
    assert np.mean(kept) == pytest.approx(0.95, abs=0.012)


def test_draws_near_a_known_code_are_half_as_far_as_known_codes_are(codes: np.ndarray) -> None:
    space = pca_space(torch.from_numpy(codes[7]), codes, 3, "codes", near=True)
    rng = np.random.default_rng(4)
    moved = torch.stack([space.draw(rng, 0.2) - space.start for _ in range(400)])
    assert moved.std(0).numpy() == pytest.approx([0.5] * 3, rel=0.15)
    assert moved.mean(0).abs().max() < 0.1


def test_projection_on_the_ball_is_the_nearest_point_and_done_once(codes: np.ndarray) -> None:
    space = pca_space(torch.from_numpy(codes.mean(axis=0)), codes, 3, "codes")
    u = torch.tensor([30.0, -40.0, 0.0], dtype=torch.float64)
    projected = space.project(u)
    assert torch.allclose(projected / projected.norm(), u / u.norm())
    assert torch.allclose(space.project(projected), projected)


def test_a_baseline_beyond_the_ball_stays_where_it_is(codes: np.ndarray) -> None:
    code0 = torch.from_numpy((codes.mean(axis=0) + 30.0 * AXES[0]).astype(np.float32))
    space = pca_space(code0, codes, 3, "codes")
    assert torch.equal(space.project(space.start), space.start)


def test_too_few_codes_are_refused_with_how_many_would_do(codes: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"6 codes: too few for 5 components.*Give attack.components=4 or less"):
        pca_space(torch.zeros(8), codes[:6], 5, "some checkpoint")
    with pytest.raises(InputError, match="do not spread along 5 directions"):
        pca_space(torch.zeros(8), codes, 5, "some checkpoint")


def test_more_components_than_a_code_has_values_are_refused() -> None:
    short = np.random.default_rng(2).standard_normal((30, 4)).astype(np.float32)
    assert len(pca_space(torch.zeros(4), short, 4, "some checkpoint").start) == 4
    with pytest.raises(InputError, match="do not spread along 5 directions"):
        pca_space(torch.zeros(4), short, 5, "some checkpoint")


def box() -> ParameterBox:
    basis = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0]], np.float32)
    low, high = np.array([-1.0, 0.0]), np.array([3.0, 0.5])
    return ParameterBox(basis, np.array([0.0, 0.5]), low, high, ("chassis.length_m", "chassis.height_m"))


def test_parameters_stay_within_their_ranges_and_the_rest_of_the_code_as_it_is() -> None:
    code0 = torch.tensor([5.0, 6.0, 7.0, 8.0])
    space = parameter_space(code0, box())
    assert torch.equal(space.code(space.start), code0)
    far = space.code(space.project(torch.tensor([9.0, -9.0], dtype=torch.float64)))
    assert far.tolist() == pytest.approx([5.0 + 3.0, 6.0 + 2.0 * (0.0 - 0.5), 7.0, 8.0])


def test_draws_of_parameters_fill_the_ranges() -> None:
    space = parameter_space(torch.zeros(4), box())
    rng = np.random.default_rng(0)
    drawn = torch.stack([space.code(space.draw(rng, 0.0)) for _ in range(500)])
    assert drawn[:, 0].min() == pytest.approx(-1.0, abs=0.05) and drawn[:, 0].max() == pytest.approx(3.0, abs=0.05)


@pytest.mark.parametrize("kind", ["pca", "parameters"])
def test_gradients_reach_the_coordinates(codes: np.ndarray, kind: str) -> None:
    code0 = torch.from_numpy(codes[0]).double()
    space = pca_space(code0, codes, 2, "codes") if kind == "pca" else parameter_space(torch.zeros(4).double(), box())
    u = space.start.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda v: space.code(v).square().sum(), (u,))
