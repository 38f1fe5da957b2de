"""Settings measured on a closed-form vehicle in a flat scene: the truth has no error, coarse settings have."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from analytic_fields import Frame, ground_scan
from attack_by_hand import CODE, FRAME, field_of
from toy_detector import WaveDetector

from shift3d.accuracy_time.cases import Case, place_case
from shift3d.accuracy_time.measure import CaseMeasurer
from shift3d.accuracy_time.settings import Setting
from shift3d.accuracy_time.truth import Truth, make_truth
from shift3d.errors import InputError
from shift3d.render import Beams, RenderSettings, SdfGrid
from shift3d.scenes.scene import Scene
from shift3d.settings.catalogue.reading import accuracy_settings
from shift3d.settings.schema.config import AccuracyConfig
from shift3d.task.spec import PlacementSpec, TaskSpec


@dataclasses.dataclass(frozen=True)
class SoftVehicle(Frame):
    """Vehicle of the closed-form family."""

    latent_code: np.ndarray = dataclasses.field(default_factory=lambda: CODE.numpy().astype(np.float32))


class SoftAssets:
    """Replacement of `task.Assets` with closed-form parts."""

    def __init__(self) -> None:
        points, origin = ground_scan(rings=48, columns=600)
        self._scene = Scene("flat", "test", points, np.broadcast_to(origin, points.shape), -1.73)
        self.scenes = self

    def names(self) -> list[str]:
        return ["flat"]

    def load(self, name: str) -> Scene:
        return self._scene

    def scene(self, spec: TaskSpec) -> tuple[Scene, Beams]:
        return self._scene, Beams.from_scene(self._scene)

    def placement_scene(self, spec: TaskSpec) -> tuple[Scene, Beams, str]:
        return *self.scene(spec), spec.scene_hash

    def vehicle(self, spec: TaskSpec) -> SoftVehicle:
        return SoftVehicle(**vars(FRAME))

    def decoder_of(self, dtype: torch.dtype) -> Any:
        class Decoder:
            field = staticmethod(field_of)

        return Decoder()

    def sdf_grid_of(self, spec: TaskSpec, settings: RenderSettings) -> SdfGrid | None:
        if not settings.sdf_grid or settings.solver != "sphere_tracing":
            return None
        return SdfGrid.of(field_of(CODE.to(settings.dtype)), FRAME, settings)

    def detector_of(self, name: str, precision: str) -> WaveDetector:
        return WaveDetector()


def setting(preset: str, name: str = "", render: dict[str, Any] | None = None, **changes: Any) -> Setting:
    accuracy = accuracy_settings(AccuracyConfig(name=preset, render=render or {}))  # type: ignore[arg-type]
    return Setting(name or preset, "presets", accuracy, **changes)


SPEC = TaskSpec(
    vehicle="soft",
    scene="",
    dataset="",
    mode="shape",
    lambda_=1.0,
    alpha=0.01,
    detector="wave",
    accuracy="reference",
    placement=PlacementSpec(8.0, 12.0, 50, attempts=80),
)
REFERENCE = setting("reference", crop_m=12.0)


@pytest.fixture(scope="module")
def assets() -> Any:
    return SoftAssets()


@pytest.fixture(scope="module")
def case(assets: Any) -> Case:
    return place_case("flat", 3, SPEC, assets)


@pytest.fixture(scope="module")
def truth(case: Case, assets: Any) -> Truth:
    return make_truth(case, assets, REFERENCE, setting("standard"), steps=3)


@pytest.fixture(scope="module")
def instrument(case: Case, assets: Any, truth: Truth) -> CaseMeasurer:
    return CaseMeasurer(case, assets, truth, REFERENCE, warm_steps=2, slow_s=30.0)


def test_the_reference_has_no_error_against_itself(instrument: CaseMeasurer, truth: Truth) -> None:
    found = instrument.look(dataclasses.replace(REFERENCE, name="again"))
    assert found["hits"] == len(truth.hits["start"].index) > 50
    assert not any(found[name] for name in ("missed", "wrong", "false", "unresolved"))
    assert max(found["depth_m"]) == 0.0 and found["residual_m"] <= 1e-9
    assert found["cosines"] == pytest.approx([1.0, 1.0]) and found["norm_ratios"] == pytest.approx([1.0, 1.0])
    assert found["score"] == found["true_score"]
    assert not any(instrument.displaced(REFERENCE)[name] for name in ("missed", "wrong", "false"))


def test_the_displaced_shape_is_another_one(truth: Truth) -> None:
    start, displaced = truth.hits["start"], truth.hits["displaced"]
    assert not torch.equal(truth.codes["start"], truth.codes["displaced"])
    assert not torch.equal(start.range_m, displaced.range_m)
    assert bool((start.chord_m >= 0).all()) and int(start.thick.sum()) > 0.9 * len(start.index)


def test_a_coarser_tolerance_has_larger_depth_errors_and_residuals(instrument: CaseMeasurer) -> None:
    fine, coarse = (
        instrument.look(setting("standard", f"to {to}", {"tolerance_m": to, "dtype": "float64"})) for to in (1e-7, 1e-3)
    )
    assert max(fine["depth_m"]) < 1e-5 < max(coarse["depth_m"]) < 0.01
    assert fine["residual_m"] <= 1e-7 < coarse["residual_m"] <= 1e-3
    assert fine["evaluations"] > coarse["evaluations"]


def test_a_blind_step_misses_hits_and_its_gradient_points_elsewhere(instrument: CaseMeasurer) -> None:
    found = instrument.look(setting("standard", "steps of 2 m", {"solver": "plain_sphere_tracing", "step_m": 2.0}))
    assert found["missed"] + found["wrong"] > 0
    assert min(found["cosines"]) < 0.9999


@pytest.mark.parametrize("attack", ["shape", "pose"])
def test_a_warm_rendering_finds_the_same_and_takes_the_gradient_of_its_attack(
    instrument: CaseMeasurer, attack: str
) -> None:
    # A pose attack keeps the shape, and so its SDF grid; a shape attack has only the previous rendering.
    chosen = setting("standard", f"warm {attack}", {"dtype": "float64"}, warm=attack, grid=attack == "pose")
    found = instrument.look(chosen)
    cold = instrument.look(setting("standard", f"cold {attack}", {"dtype": "float64"}))
    assert found["missed"] + found["wrong"] + found["false"] <= 0.01 * found["hits"]
    assert len(found["cosines"]) == 1 and found["cosines"][0] > 0.999
    assert found["evaluations"] < cold["evaluations"]


def test_an_sdf_grid_saves_evaluations_and_loses_nothing(instrument: CaseMeasurer) -> None:
    chosen = setting("standard", "no grid", {"dtype": "float64"})
    plain, mapped = (instrument.look(dataclasses.replace(chosen, grid=grid)) for grid in (False, True))
    assert mapped["missed"] + mapped["wrong"] + mapped["false"] == 0
    assert mapped["evaluations"] < plain["evaluations"]


def test_what_is_slow_is_not_rendered_twice(case: Case, assets: Any, truth: Truth) -> None:
    never = CaseMeasurer(case, assets, truth, REFERENCE, warm_steps=1, slow_s=0.0)
    found = never.look(setting("standard", "slow", {"dtype": "float64"}))
    assert found["hits"] == len(truth.hits["start"].index) and found["missed"] == 0


def test_times_are_of_whole_renderings_and_steps(instrument: CaseMeasurer) -> None:
    chosen = setting("standard", "timed")
    assert 0 < instrument.sample(chosen) < 60_000
    step = instrument.step(chosen)
    assert 0 < step["render_ms"] < step["step_ms"] and 0 < step["detector_ms"] < step["step_ms"]


def test_a_distance_that_no_scene_has_room_at_is_said(assets: Any) -> None:
    far = dataclasses.replace(SPEC, placement=PlacementSpec(70.0, 71.0, 50, attempts=5))
    with pytest.raises(InputError, match="70 to 71 m"):
        place_case("flat", 0, far, assets)


@pytest.mark.parametrize("variable", ["shape", "pose"])
def test_a_cold_rendering_prepares_the_gradient_that_a_warm_one_prepares(
    instrument: CaseMeasurer, variable: str
) -> None:
    chosen = setting("standard", f"cold, {variable}", {"dtype": "float64"}, gradient=variable)
    assert len(instrument.look(chosen)["cosines"]) == 1
    plain = dataclasses.replace(chosen, gradient="no")
    assert len(instrument.look(plain)["cosines"]) == 2
    assert chosen.rendering_key != plain.rendering_key != dataclasses.replace(chosen, warm=variable).rendering_key


def test_attacks_end_with_a_score_of_the_shape_and_one_of_the_pose(instrument: CaseMeasurer) -> None:
    scores = instrument.attack(setting("standard", "attacked", attack_steps=2))["scores"]
    assert len(scores) == 2 and all(0.0 <= score <= 1.0 for score in scores)
