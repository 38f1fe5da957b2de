"""Base types of the schema: strict records and bounded numbers."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Seed = Annotated[int, Field(ge=0, lt=2**63)]
# Values beyond these limits are typing errors: 10**12 scenes, or 1e300, whose square is infinite.
_MOST, LARGEST = 10**6, 1e9
Count = Annotated[int, Field(ge=1, le=_MOST)]
NonNegativeInt = Annotated[int, Field(ge=0, le=_MOST)]
Positive = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False)]
Share = Annotated[float, Field(gt=0, lt=1)]
NonNegativeFloat = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]


class Record(BaseModel):
    """Group of settings. Unknown fields are errors, and so are texts for numbers."""

    # strict: "0.5" is no number and true is not 1, because Hydra has parsed the types. 1 is valid for a float.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
