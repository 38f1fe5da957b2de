"""A few of the extreme poses in every test run; `extreme_poses.py` runs thousands."""

import pytest
import torch
from extreme_cases import make_case
from extreme_poses import Outcome, run_case, summary
from torch import Tensor

from shift3d.render.culling import Rays
from shift3d.render.field.linearization import Linearization
from shift3d.render.field.object_field import ObjectField
from shift3d.render.solvers import search, sphere_tracing
from shift3d.render.solvers.roots import find_roots


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    return [run_case(number) for number in range(40)]


def test_forty_extreme_poses_and_codes_are_sound(outcomes: list[Outcome]) -> None:
    assert [outcome for outcome in outcomes if not outcome.sound] == []
    totals = summary(outcomes)
    # The cases are as intended: some beams meet the object, some start inside it.
    assert totals["hits"] > 300 and totals["unresolved"]["sensor inside the object"] > 60
    assert totals["beams_that_passed_a_surface"] == 0 < totals["beams_looked_along"]


def test_a_beam_from_inside_the_object_passes_no_surface() -> None:
    """The sensor of this case is 7 mm inside; the first sample of its beam is 13 mm away, outside."""
    outcome = run_case(9681)
    assert outcome.looked_along == outcome.passed == 0 < outcome.unresolved["sensor inside the object"]


def test_a_case_follows_from_its_number() -> None:
    one, same, other = make_case(7), make_case(7), make_case(8)
    assert (one.theta == same.theta).all() and (one.code == same.code).all()
    assert not (one.theta == other.theta).any()


def _taken_for_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    """Count beams of a sensor inside the object as if they began outside."""
    outside = sphere_tracing.outside

    def anywhere(rays: Rays, field: ObjectField) -> tuple[Rays, Tensor, Tensor]:
        rays, g, undecided = outside(rays, field)
        return rays, g.abs() + 1e-3, torch.zeros_like(undecided)

    monkeypatch.setattr(sphere_tracing, outside.__name__, anywhere)


def _no_root_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (sphere_tracing, search):
        monkeypatch.setattr(module, find_roots.__name__, lambda *given: find_roots(*given[:-1], 0))


def _divided_by_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Divide gradients by pose and code by 0."""
    change = Linearization.change

    def broken(linearization: Linearization, field: ObjectField, x_object: Tensor) -> Tensor:
        found = change(linearization, field, x_object)
        if found.requires_grad:
            found.register_hook(lambda gradient: gradient / 0.0)
        return found

    monkeypatch.setattr(Linearization, change.__name__, broken)


_BROKEN = {
    "from_inside": _taken_for_outside,
    "crossing that did not settle": _no_root_looked_for,
    "not_finite": _divided_by_nothing,
}


@pytest.mark.parametrize("shows", list(_BROKEN))
def test_it_notices(shows: str, outcomes: list[Outcome], monkeypatch: pytest.MonkeyPatch) -> None:
    inside = shows == "from_inside"
    numbers = [o.number for o in outcomes if (o.unresolved if inside else o.hits > 20 and o.settings == "plain")]
    _BROKEN[shows](monkeypatch)
    assert any(_shown(run_case(number), shows) for number in numbers[:2])


def _shown(outcome: Outcome, name: str) -> int:
    return outcome.unresolved[name] if " " in name else int(bool(getattr(outcome, name)))
