"""Checks of ramps, sines and stops: the plant's set-point along the way, at its time."""

from __future__ import annotations

from math import pi, sin

from pmabench.base.clock import VirtualClock
from pmabench.base.quantities import show
from pmabench.bench.interface import Follower, Motion, OutputRecord, Segment
from pmabench.conformance.commands import MOVES, at, close_enough, commanded, near, reaches
from pmabench.conformance.rig import CALLS_WITHIN, COLLECTS_WITHIN, Rig
from pmabench.conformance.samples import RATE
from pmabench.conformance.truth import Truth
from pmabench.conformance.verdict import Failed, Late, NotApplicable

BEHIND = 0.12
"""How far a ramp may be from its time [s]."""


def ramps(rig: Rig) -> str:
    """A ramp and a sine are followed to their end, at their time, in the plant; the next write ends them."""
    if not rig.record.outputs or not issubclass(rig.driver(), Follower):
        raise NotApplicable("it follows no ramps")
    truth = rig.truth()
    with rig.opened() as device:
        if rig.streams():
            rig.call("start()", device.start, RATE).good(COLLECTS_WITHIN)
        for output in rig.record.outputs:
            origin, target = at(output, 0.1), at(output, 0.4)
            swing = at(output, 0.05) - at(output, 0.0)
            _begin_at(rig, truth, output, origin)
            ramp = Segment("ramp", rig.bench_clock.now(), origin, target, rate=abs(target - origin) / 1.0)
            _watch(rig, truth, output, ramp, 1.0)
            sine = Segment("sine", rig.bench_clock.now() + 0.3, target, amplitude=swing, frequency=1.0, cycles=1.0)
            _watch(rig, truth, output, sine, 1.0)
            back = Segment("ramp", rig.bench_clock.now(), target, origin, rate=abs(target - origin) / 2.0)
            rig.call("follow()", device.follow, output.output, back).nothing(CALLS_WITHIN)
            rig.pass_time(0.4)
            rig.call("write()", device.write, output.output, target).nothing(CALLS_WITHIN)
            rig.pass_time(0.6)
            held = rig.call("read_back()", device.read_back, output.output).good(CALLS_WITHIN)
            if not near(output, held, target) or not reaches(rig, truth, output, target):
                raise Failed(f"{output.name}: {target:g} was written and the device still follows: it holds {held!r}")
    return "a ramp and a sine of 1 s, in the plant as they were commanded, and a write ends them"


def _begin_at(rig: Rig, truth: Truth, output: OutputRecord, value: float) -> None:
    rig.call("write()", rig.device.write, output.output, value).nothing(CALLS_WITHIN)
    until = rig.bench_clock.now() + MOVES
    while not reaches(rig, truth, output, value, 0.05):
        rig.feed()
        if rig.bench_clock.now() > until:
            raise Failed(f"{output.name}: {value:g} was written and did not arrive in the plant within {MOVES:g} s")


def _watch(rig: Rig, truth: Truth, output: OutputRecord, segment: Segment, lasts: float) -> None:
    """Raise Failed where the plant's set-point leaves the segment, or does not end where it ends."""

    def value(moment: float) -> float:
        since = min(max(moment - segment.start, 0.0), lasts)
        if segment.kind == "ramp":
            return segment.origin + (segment.target - segment.origin) * since / lasts
        return segment.origin + segment.amplitude * sin(2 * pi * segment.frequency * since)

    si, clock = output.scale.to_si, rig.bench_clock
    rig.call(f"follow({segment.kind})", rig.device.follow, output.output, segment).nothing(CALLS_WITHIN)
    seen, reached, fed = [], [], clock.now()
    while clock.now() < segment.start + lasts + 2 * BEHIND:
        before = clock.now()
        got = commanded(truth, output)
        reached.append(got)
        around = [float(si(value(before + BEHIND * step / 6))) for step in range(-12, 4)]
        seen.append(max(min(around) - got, got - max(around), 0.0))
        if clock.now() - fed > 0.1:
            rig.feed()
            fed = clock.now()
        clock.wait_until(clock.now() + 0.02)
    room = close_enough(output) + 0.02 * abs(float(si(value(segment.start + lasts / 4))) - float(si(segment.origin)))
    off = [distance for distance in seen if distance > room]
    if len(off) > 0.1 * len(seen):
        message = (
            f"{output.name}: the plant's set-point is up to {show(max(off), output.quantity)} away from the "
            f"{segment.kind} that was commanded ({len(off)} of {len(seen)} looks)"
        )
        raise Failed(message) if isinstance(clock, VirtualClock) else Late(message)
    crests = [float(si(segment.origin + sign * segment.amplitude)) for sign in (-1, 1)]
    if max(reached) - min(reached) < 0.8 * abs(crests[1] - crests[0]):
        swing = show(max(reached) - min(reached), output.quantity)
        raise Late(
            f"{output.name}: a sine from crest to crest of {show(crests[1] - crests[0], output.quantity)} is {swing}"
        )
    end = segment.target if segment.kind == "ramp" else segment.origin
    if not reaches(rig, truth, output, end, 0.5):
        left = show(commanded(truth, output), output.quantity)
        raise Failed(f"{output.name}: a {segment.kind} to {show(float(si(end)), output.quantity)} ended at {left}")
    held = rig.call("read_back()", rig.device.read_back, output.output).good(CALLS_WITHIN)
    if not near(output, held, end):
        raise Failed(f"{output.name}: after a {segment.kind} that ends at {end:g}, {held!r} is read back")


def halts(rig: Rig) -> str:
    """`halt` stops a ramp where it is, and holds."""
    if not rig.record.outputs or not issubclass(rig.driver(), Motion):
        raise NotApplicable("it stops no motion by itself")
    truth = rig.truth()
    with rig.opened() as device:
        if rig.streams():
            rig.call("start()", device.start, RATE).good(COLLECTS_WITHIN)
        for output in rig.record.outputs:
            origin, target = at(output, 0.1), at(output, 0.4)
            _begin_at(rig, truth, output, origin)
            ramp = Segment("ramp", rig.bench_clock.now(), origin, target, rate=abs(target - origin) / 1.5)
            rig.call("follow()", device.follow, output.output, ramp).nothing(CALLS_WITHIN)
            rig.pass_time(0.7)
            rig.call("halt()", device.halt, output.output).nothing(CALLS_WITHIN)
            rig.pass_time(0.2)
            stopped = commanded(truth, output)
            rig.pass_time(0.5)
            after = commanded(truth, output)
            low, high = sorted(float(output.scale.to_si(value)) for value in (origin, target))
            if abs(after - stopped) > 2 * close_enough(output):
                raise Failed(f"{output.name}: 0.2 s after halt() it still moves in the plant")
            if not low + 0.1 * (high - low) < stopped < high - 0.1 * (high - low):
                where = show(stopped, output.quantity)
                raise Late(f"{output.name}: halt() in the middle of a ramp left the plant at {where}, not where it was")
    return "a ramp stops where it is"
