"""What no device follows is refused before anything is sent; of a step without an answer the guard knows."""

import math
from dataclasses import replace
from itertools import pairwise

import pytest
from pmabench_drivers.shared.device import Stepped, refuse_nonsense, stepped
from pmabench_drivers.shared.link import Unanswered

from pmabench.base.clock import VirtualClock
from pmabench.base.errors import DeviceError, NotSent
from pmabench.bench.interface import DeviceRecord, OutputRecord, Scale, Segment

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


class Steps(Stepped):
    """A device whose answers are lost while `lost`."""

    lost = False

    def __init__(self, *made):
        super().__init__(*made)
        self.sent = []

    @staticmethod
    def read_options(device, reader):
        return None

    def close(self):
        pass

    def _begin_steps(self):
        pass

    def _refuse_value(self, output, value):
        pass

    def _send_step(self, output, value, still, *, last):
        self.sent.append(value)
        if self.lost:
            self.write_between()
            raise Unanswered("regulator", "no answer within 0.1 s", output)

    def write_between(self):
        """A vent that takes over while the step is under way."""
        self._following.clear()


def test_a_step_that_is_not_answered_is_known_although_a_vent_took_over_meanwhile():
    """The device may carry it out after the safe value: the guard must send that again."""
    clock = VirtualClock()
    output = OutputRecord("pressure", "pressure", "regulator", "p", Scale(), 0.0, 0.0, 0.0, 6e5)
    device = Steps(DeviceRecord("regulator", "x:Y", outputs=(output,)), clock)
    device.follow("p", RAMP)
    clock.wait_until(1.5)
    assert device._step() is None
    assert device.unanswered == -math.inf
    device.lost = True
    assert device._step() is None, "nobody waits for the segment any more"
    assert device.unanswered == 1.5


def test_a_step_whose_answer_refuses_it_cannot_come_later(monkeypatch):
    clock = VirtualClock()
    output = OutputRecord("pressure", "pressure", "regulator", "p", Scale(), 0.0, 0.0, 0.0, 6e5)
    device = Steps(DeviceRecord("regulator", "x:Y", outputs=(output,)), clock)
    monkeypatch.setattr(device, "write_between", lambda: refuse())

    def refuse():
        raise NotSent("regulator", "holds 120", output.output)

    device.lost = True
    device.follow("p", RAMP)
    clock.wait_until(1.5)
    assert isinstance(device._step(), NotSent)
    assert device.unanswered == -math.inf


@pytest.mark.parametrize(("quantity", "leap"), [("length", 1.5 * 0.05), ("angle", 1.5 * 0.05), ("pressure", 0.22)])
@pytest.mark.parametrize("segment", [RAMP, SINE])
def test_a_motion_is_led_back_to_its_course_after_a_stall_and_does_not_leap(quantity, leap, segment):
    """Closed form: at 100 steps a second, 0.22 s of stall in the fastest part of the course; the end comes all the same."""
    clock = VirtualClock()
    output = OutputRecord("x", quantity, "dac", "p", Scale(), 0.0, 0.0, 0.0, 10.0, rate=8.0)
    device = Steps(DeviceRecord("dac", "x:Y", outputs=(output,)), clock)
    device.follow("p", segment)
    fastest = 2 * math.pi * 0.5 * 2.0 if segment is SINE else 2.0
    steps = [0.01 * k for k in range(90, 1000) if not 200 <= k < 222]
    for moment in steps:
        clock.wait_until(moment)
        device._step()
    assert max(abs(b - a) for a, b in pairwise(device.sent)) == pytest.approx(fastest * leap, rel=0.2)
    assert device.sent[-1] == (5.0 if segment is RAMP else segment.origin)
    assert device._following == {}
    before = [stepped(segment, moment)[0] for moment in steps if 1.0 <= moment < 2.0]
    assert device.sent[: len(before)] == before, "as it is without a stall"
