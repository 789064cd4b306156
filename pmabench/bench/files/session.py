"""What a bench file says of its session: self-test, warm-up, zeros."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, WithJsonSchema, model_validator

from pmabench.base.quantities import without_number
from pmabench.bench.files import specimen as s
from pmabench.files import quantity as q
from pmabench.files.document import Strict, among, schema_of

PLACED = ("displacement", "angle")
"""Channels whose zero is at a position that the operator sets by hand."""


ZEROED, ZEROED_EACH = ("pressure", "force", *PLACED), ("pressure",)
"""Channels that may have a zero, and those of them that each of several muscles has."""
Zeroed = Annotated[str, BeforeValidator(among(ZEROED, ZEROED_EACH)), WithJsonSchema(schema_of(ZEROED, ZEROED_EACH))]


class WarmUpFile(Strict):
    """Cycles between no pressure and `pressure` before the zeros are taken."""

    duration: q.Time = 600.0
    pressure: s.PressureAbove0
    period: s.TimeAbove0 = 10.0


class ZeroFile(Strict):
    """The zero of one channel: at most `most` away from where its calibration has it."""

    most: s.Reading
    at: s.Text = ""
    """Where a displacement or an angle is zero, in words for the operator."""
    load: q.Load | None = None
    """The load that brings the free end there."""


class SelfTestFile(Strict):
    """The start check: pressure goes up in steps of `step` to `pressure`, and every channel is looked at."""

    step: s.PressureAbove0 = 25e3
    pressure: s.PressureAbove0 | None = None
    """Highest pressure; the bench's set-up pressure if not given."""
    settle: s.TimeAbove0 = 3.0
    """Time at each pressure."""
    load: q.Load | None = None
    """Load that is on its support during the check."""
    noise: dict[s.Name, s.Reading] = {}
    """Largest rms noise per channel; 0.5 % of the range if not given."""
    linearity: s.RatioAbove0 = 0.05
    """Largest deviation of the regulator from a straight line, as a fraction of the highest pressure."""
    alignment: s.TimeAbove0 = 0.02
    """Largest delay between force and pressure."""
    leak: s.RateAbove0 = 5e3 / 60
    """Largest rate at which the pressure may fall with the isolation valve shut."""


class SessionFile(Strict):
    """Done once before the first run, and again when it has run out."""

    self_test: SelfTestFile | None = None
    warm_up: WarmUpFile | None = None
    zeros: dict[Zeroed, ZeroFile] = {}
    valid: s.TimeAbove0 = 12 * 3600.0

    @model_validator(mode="after")
    def _references(self) -> SessionFile:
        for name, zero in self.zeros.items():
            placed = without_number(name)[0] in PLACED
            if placed and not zero.at:
                raise ValueError(f'the zero of the {name} needs "at": where the free end is then, in words')
            if not placed and (zero.at or zero.load is not None):
                text = f'"at" and "load" belong to the displacement or the angle; {name} is zeroed without any'
                raise ValueError(text)
        return self
