"""What every group of settings is made of: strict records, and numbers within bounds."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Seed = Annotated[int, Field(ge=0, lt=2**63)]
# Beyond these limits lie typing errors: a list of 10**12 scenes, squares of 1e300 that are infinite.
_MOST, LARGEST = 10**6, 1e9
Count = Annotated[int, Field(ge=1, le=_MOST)]
Number = Annotated[int, Field(ge=0, le=_MOST)]
Positive = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False)]
Share = Annotated[float, Field(gt=0, lt=1)]
NotNegative = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]


class Record(BaseModel):
    """A group of settings. Unknown fields are errors; numbers are not read from texts."""

    # strict: "0.5" is no number and true is no 1, since Hydra has read the types already. A float may be written 1.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
