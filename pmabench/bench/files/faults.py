"""The file of what goes wrong, and when, while `pmabench emulate` serves; which faults there are the emulator knows."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from pmabench.files.document import Strict
from pmabench.files.quantity import Load, Time


class Event(Strict):
    """One thing that happens: a fault of a device, a fault of the plant, or another load on the free end."""

    after: Time = 0.0
    """Since it is served."""
    device: Annotated[str, Field(max_length=60)] | None = None
    fault: Annotated[str, Field(max_length=60)] | None = None
    value: str | int | float | None = None
    """How much, with its unit where it has one; what is usual for the fault where not given."""
    count: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """So many answers or samples; until it is cleared where not given."""
    lasts: Annotated[Time, Field(gt=0)] | None = Field(default=None, alias="for")
    plant: Annotated[str, Field(max_length=60)] | None = None
    load: Load | None = None

    @model_validator(mode="after")
    def _one(self) -> Event:
        given = [self.device is not None or self.fault is not None, self.plant is not None, self.load is not None]
        if sum(given) != 1 or (self.device is None) != (self.fault is None):
            raise ValueError('either "device" with its "fault", or "plant", or "load" is expected')
        if self.device is None and (self.value is not None or self.count is not None):
            raise ValueError('"value" and "count" belong to the fault of a device')
        if self.load is not None and self.lasts is not None:
            raise ValueError('a load stays until another one comes; leave "for" out')
        return self


class FaultsFile(Strict):
    """What goes wrong while a bench is emulated."""

    schema_: Annotated[Literal["pmabench.faults/1"], Field(alias="schema")]
    faults: Annotated[list[Event], Field(min_length=1, max_length=1000)]
