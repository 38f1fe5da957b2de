"""A few of the extreme poses, whatever else is tested; `extreme_poses.py` runs thousands."""

import sys
from pathlib import Path

import pytest
from extreme_cases import make_case
from extreme_poses import Outcome, run_case, summary

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "hard_cases"))
from catalogue import Edit, without


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    return [run_case(number) for number in range(60)]


def test_sixty_extreme_poses_and_codes_are_sound(outcomes: list[Outcome]) -> None:
    assert [outcome for outcome in outcomes if not outcome.sound] == []
    totals = summary(outcomes)
    # They are what they claim to be: some meet the object, some start inside it.
    assert totals["hits"] > 500 and totals["unresolved"]["sensor inside the object"] > 100
    assert totals["beams_that_passed_a_surface"] == 0 < totals["beams_looked_along"]


def test_a_case_follows_from_its_number() -> None:
    one, same, other = make_case(7), make_case(7), make_case(8)
    assert (one.theta == same.theta).all() and (one.code == same.code).all()
    assert not (one.theta == other.theta).any()


# What is taken out of the renderer, and where it must show: beams of a sensor inside the object that count as hits;
# roots that are not looked for; a gradient divided by whatever the slope is.
_BROKEN = {
    "from_inside": Edit(
        "shift3d.render.bracket", "self.undecided[rows[at_sensor]] = True", "self.found[rows[at_sensor]] = True"
    ),
    "crossing that did not settle": Edit(
        "shift3d.render.itp", "for count in range(max_iterations):", "for count in range(0):"
    ),
    "not_finite": Edit("shift3d.render.implicit", "1.0 / torch.where(steep < 0, steep, 1.0)", "1.0 / (steep - steep)"),
}


@pytest.mark.parametrize("shows", list(_BROKEN))
def test_it_notices(shows: str, outcomes: list[Outcome]) -> None:
    inside = shows == "from_inside"
    numbers = [o.number for o in outcomes if (o.unresolved if inside else o.hits > 20 and o.settings == "itp")]
    with without((_BROKEN[shows],)):
        assert any(_shown(run_case(number), shows) for number in numbers[:2])


def _shown(outcome: Outcome, name: str) -> int:
    return outcome.unresolved[name] if " " in name else int(bool(getattr(outcome, name)))
