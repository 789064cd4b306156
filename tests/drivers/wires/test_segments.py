"""What no device follows is refused before anything is sent."""

import math
from dataclasses import replace

import pytest
from pmabench_drivers.shared.device import refuse_nonsense

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Segment

RAMP = Segment("ramp", 1.0, 0.0, 5.0, rate=2.0)
SINE = Segment("sine", 1.0, 5.0, amplitude=2.0, frequency=0.5, cycles=3.0)


@pytest.mark.parametrize("segment", [RAMP, SINE, replace(RAMP, start=-1.0)])
def test_ramps_and_sines_are_followed(segment):
    refuse_nonsense("regulator", "pressure", segment)


@pytest.mark.parametrize(
    ("segment", "why"),
    [
        (replace(RAMP, kind="step"), "cannot follow"),
        (replace(RAMP, start=math.nan), "cannot follow"),
        (replace(RAMP, target=math.inf), "cannot follow"),
        (replace(SINE, amplitude=math.nan), "cannot follow"),
        (replace(RAMP, rate=0.0), "a ramp needs a rate above zero"),
        (replace(RAMP, rate=-1.0), "a ramp needs a rate above zero"),
        (replace(SINE, frequency=0.0), "a sine needs a rate above zero"),
    ],
)
def test_nonsense_is_refused(segment, why):
    with pytest.raises(DeviceError, match=f"^regulator.pressure: {why}"):
        refuse_nonsense("regulator", "pressure", segment)
