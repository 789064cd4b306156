"""What a bench file says about its session: self-test, warm-up, zeros, and for how long they count."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from pmabench.bench.files.parts import Name, PressureAbove0, RateAbove0, RatioAbove0, Reading, Text, TimeAbove0
from pmabench.files.document import Strict
from pmabench.files.quantity import Load, Time

PLACED = ("displacement", "angle")
"""Channels whose zero is where hands bring the free end."""


class WarmUpFile(Strict):
    """Cycles between no pressure and `pressure` before the zeros are taken."""

    duration: Time = 600.0
    pressure: PressureAbove0
    period: TimeAbove0 = 10.0


class ZeroFile(Strict):
    """The zero of one channel: at most `most` away from where its calibration has it."""

    most: Reading
    at: Text = ""
    """Where a displacement or an angle is zero, in words for the operator."""
    load: Load | None = None
    """The load that brings the free end there."""


class SelfTestFile(Strict):
    """The start check: pressure goes up in steps of `step` to `pressure`, and every channel is looked at."""

    step: PressureAbove0 = 25e3
    pressure: PressureAbove0 | None = None
    """Highest pressure; the bench's set-up pressure if not given."""
    settle: TimeAbove0 = 3.0
    """Time at each pressure."""
    load: Load | None = None
    """A load that is on its support meanwhile."""
    noise: dict[Name, Reading] = {}
    """Most rms noise per channel; 0.5 % of the range if not given."""
    linearity: RatioAbove0 = 0.05
    """Most by which the regulator may leave its straight line, of the highest pressure."""
    alignment: TimeAbove0 = 0.02
    """Most time between force and pressure."""
    leak: RateAbove0 = 5e3 / 60
    """Most that the pressure may fall with the isolation valve shut."""


class SessionFile(Strict):
    """Done once before the first run, and again when it has run out."""

    self_test: SelfTestFile | None = None
    warm_up: WarmUpFile | None = None
    zeros: dict[Literal["pressure", "force", "displacement", "angle"], ZeroFile] = {}
    valid: TimeAbove0 = 12 * 3600.0

    @model_validator(mode="after")
    def _references(self) -> SessionFile:
        for name, zero in self.zeros.items():
            placed = name in PLACED
            if placed and not zero.at:
                raise ValueError(f'the zero of the {name} needs "at": where the free end is then, in words')
            if not placed and (zero.at or zero.load is not None):
                raise ValueError(
                    f'"at" and "load" belong to the displacement or the angle; {name} is zeroed without any'
                )
        return self
