"""Settings of the search and of the placement of its vehicle."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import ConfigDict, Field, model_validator

from shift3d.attack.names import OVER_KINDS, SearchName, SpaceName
from shift3d.settings.schema.records import LARGEST, Count, NonNegativeFloat, NonNegativeInt, Positive, Record


class PlacementConfig(Record):
    """Limits for the placement of a vehicle; metres."""

    min_range_m: NonNegativeFloat
    max_range_m: Positive
    min_object_points: NonNegativeInt
    overlap_m: NonNegativeFloat
    contact_m: Positive
    attempts: Count

    @model_validator(mode="after")
    def _a_ring(self) -> Self:
        if self.min_range_m >= self.max_range_m:
            raise ValueError(f"min_range_m {self.min_range_m:g} is not below max_range_m {self.max_range_m:g}")
        return self


class AttackConfig(Record):
    """Settings of the search and of the comparison methods.

    selection_window: number of steps before and after a step that count in the selection of the best step.
    below_ground_m, search, space, components, rate, placements, starts, random_search, naturalness: see
    `task.spec.AttackSpec`. edit: NAME:PLACE, a vehicle parameter and a place in its range, for the method ``edited``.
    search_scenes: number of further scenes in each shape's loss. transfer_scenes: number of other scenes that receive
    the found shape.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, populate_by_name=True)

    steps: NonNegativeInt
    selection_window: NonNegativeInt = 0
    alpha: Positive
    lambda_: Annotated[float, Field(alias="lambda", ge=0, le=LARGEST, allow_inf_nan=False)]
    random_replicates: NonNegativeInt
    noise_replicates: NonNegativeInt
    noise_sigma: NonNegativeFloat
    noise_share: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = 0.0
    max_shift_m: NonNegativeFloat
    max_tilt_rad: NonNegativeFloat
    below_ground_m: NonNegativeFloat = 0.05
    detection_radius_m: Annotated[float, Field(gt=0, le=5, allow_inf_nan=False)]
    search: SearchName = "descent"
    space: SpaceName = "free"
    components: Annotated[int, Field(ge=1, le=256)] = 10
    rate: Positive = 0.1
    placements: Annotated[int, Field(ge=1, le=64)] = 2
    starts: Annotated[int, Field(ge=1, le=64)] = 1
    random_search: Annotated[int, Field(ge=0, le=1)] = 0
    naturalness: Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)] = 0.0
    search_scenes: NonNegativeInt = 0
    transfer_scenes: NonNegativeInt = 0
    edit: str = ""
    placement: PlacementConfig

    @model_validator(mode="after")
    def _searches_over_kinds(self) -> Self:
        if self.space == "family" and self.search not in OVER_KINDS:
            what = f"search {self.search} stays with one kind, and space family goes over kinds"
            raise ValueError(what, f"Give attack.search={' or '.join(OVER_KINDS)}")
        return self

    @model_validator(mode="after")
    def _budget_in_percent(self) -> Self:
        if 0.0 < self.naturalness < 1.0:
            what = f"naturalness is {self.naturalness:g}, and a percentile goes from 1 to 100"
            raise ValueError(what, f"Give attack.naturalness={100.0 * self.naturalness:g}, or 0 for no limit")
        return self

    @model_validator(mode="after")
    def _steps_beside_the_starts(self) -> Self:
        wanted = self.starts > 1 or self.steps > 0
        needed = self.starts - 1 + self.placements
        if self.search == "expectation" and wanted and needed > self.steps:
            what = f"starts {self.starts:d} and placements {self.placements:d} leave nothing of {self.steps:d} steps"
            raise ValueError(what, f"Give attack.steps={needed:d} or more, or a smaller attack.starts")
        return self
