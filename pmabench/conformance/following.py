"""Checks of functions in the device: ramps, sines, stops; its watchdog; its report in `held` (promise S11)."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi, sin
from typing import Any

from pmabench.base.errors import DeviceError
from pmabench.base.quantities import show
from pmabench.bench.interface import OutputRecord, Segment, Watchdog
from pmabench.conformance.commands import MOVES, at, close_enough, commanded, lift, near, reaches, refuse_unsafe
from pmabench.conformance.relay import silence
from pmabench.conformance.rig import Failed, Late, Rig
from pmabench.conformance.samples import RATE

BEHIND = 0.12
"""Largest time deviation of a ramp [s]."""
EARLY, LATEST = 0.1, 0.25
"""How much before and after its time a watchdog may fire [s]."""
NOTICED = 0.5
"""Time within which a difference must appear in `held` [s]."""


def ramps(rig: Rig) -> str:
    """A ramp and a sine are followed to their end, at their time, in the plant; the next write ends them."""
    with rig.opened(rate=RATE) as device:
        for output in rig.record.outputs:
            origin, target = at(output, 0.1), at(output, 0.4)
            swing = at(output, 0.05) - at(output, 0.0)
            _begin_at(rig, output, origin)
            ramp = Segment("ramp", rig.bench_clock.now(), origin, target, rate=abs(target - origin) / 1.0)
            _watch(rig, output, ramp, 1.0)
            sine = Segment("sine", rig.bench_clock.now() + 0.3, target, amplitude=swing, frequency=1.0, cycles=1.0)
            _watch(rig, output, sine, 1.0)
            back = Segment("ramp", rig.bench_clock.now(), target, origin, rate=abs(target - origin) / 2.0)
            rig.call("follow()", device.follow, output.output, back).nothing()
            rig.pass_time(0.4)
            rig.call("write()", device.write, output.output, target).nothing()
            rig.pass_time(0.6)
            held = rig.call("read_back()", device.read_back, output.output).good()
            if not near(output, held, target) or not reaches(rig, output, target):
                raise Failed(f"{output.name}: {target:g} was written and the device still follows: it holds {held!r}")
    return "a ramp and a sine of 1 s, in the plant as they were commanded, and a write ends them"


def _begin_at(rig: Rig, output: OutputRecord, value: float) -> None:
    rig.call("write()", rig.device.write, output.output, value).nothing()
    until = rig.bench_clock.now() + MOVES
    while not reaches(rig, output, value, 0.05):
        rig.feed()
        if rig.bench_clock.now() > until:
            raise Failed(f"{output.name}: {value:g} was written and did not arrive in the plant within {MOVES:g} s")


def _watch(rig: Rig, output: OutputRecord, segment: Segment, lasts: float) -> None:
    """Raise Failed if the plant's set-point deviates from the segment, or does not end at its end."""

    def value(moment: float) -> float:
        since = min(max(moment - segment.start, 0.0), lasts)
        if segment.kind == "ramp":
            return segment.origin + (segment.target - segment.origin) * since / lasts
        return segment.origin + segment.amplitude * sin(2 * pi * segment.frequency * since)

    si, clock = output.scale.to_si, rig.bench_clock
    rig.call(f"follow({segment.kind})", rig.device.follow, output.output, segment).nothing()
    seen, reached, fed = [], [], clock.now()
    while clock.now() < segment.start + lasts + 2 * BEHIND:
        before = clock.now()
        got = commanded(rig, output)
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
        away = f"up to {show(max(off), output.quantity)} away from the {segment.kind} that was commanded"
        raise Late(f"{output.name}: the plant's set-point is {away} ({len(off)} of {len(seen)} looks)")
    crests = [float(si(segment.origin + sign * segment.amplitude)) for sign in (-1, 1)]
    if max(reached) - min(reached) < 0.8 * abs(crests[1] - crests[0]):
        swing, wanted = (show(max(ends) - min(ends), output.quantity) for ends in (reached, crests))
        raise Late(f"{output.name}: a sine from crest to crest of {wanted} is {swing}")
    end = segment.target if segment.kind == "ramp" else segment.origin
    if not reaches(rig, output, end, 0.5):
        left = show(commanded(rig, output), output.quantity)
        raise Failed(f"{output.name}: a {segment.kind} to {show(float(si(end)), output.quantity)} ended at {left}")
    held = rig.call("read_back()", rig.device.read_back, output.output).good()
    if not near(output, held, end):
        raise Failed(f"{output.name}: after a {segment.kind} that ends at {end:g}, {held!r} is read back")


def halts(rig: Rig) -> str:
    """`halt` stops a ramp where it is, and holds."""
    with rig.opened(rate=RATE) as device:
        for output in rig.record.outputs:
            origin, target = at(output, 0.1), at(output, 0.4)
            _begin_at(rig, output, origin)
            ramp = Segment("ramp", rig.bench_clock.now(), origin, target, rate=abs(target - origin) / 1.5)
            rig.call("follow()", device.follow, output.output, ramp).nothing()
            rig.pass_time(0.7)
            rig.call("halt()", device.halt, output.output).nothing()
            rig.pass_time(0.2)
            stopped = commanded(rig, output)
            rig.pass_time(0.5)
            after = commanded(rig, output)
            low, high = sorted(float(output.scale.to_si(value)) for value in (origin, target))
            if abs(after - stopped) > 2 * close_enough(output):
                raise Failed(f"{output.name}: 0.2 s after halt() it still moves in the plant")
            if not low + 0.1 * (high - low) < stopped < high - 0.1 * (high - low):
                where = show(stopped, output.quantity)
                raise Late(f"{output.name}: halt() in the middle of a ramp left the plant at {where}, not where it was")
    return "a ramp stops where it is"


def watchdog(rig: Rig) -> str:
    """Armed, it says the time that the device holds; fed, it is quiet; without that the device vents at that time."""
    asked = rig.record.watchdog
    with rig.opened(armed=False) as device:
        armed = _arm(rig, device)
        lift(rig)
        _feed(rig, device, 1.5 * asked)
        rig.call("disarm_watchdog()", device.disarm_watchdog).nothing()
        rig.wait(asked + LATEST)
        if rig.logged("watchdog"):
            raise Failed(f"the device vented {asked:g} s after disarm_watchdog()")
        armed = _arm(rig, device)
        lift(rig)
        _feed(rig, device, 0.3)
        rig.wait(armed + LATEST + 0.25)
        if not (fired := rig.logged("watchdog")):
            raise Failed(f"the emulated device did nothing {armed + LATEST:g} s after it was fed last")
        silent = fired[0].get("silent", armed)
        if not armed - EARLY <= silent <= armed + LATEST:
            message = f"arm_watchdog({asked:g}) gave {armed:g} s, and the device vented after {silent:.2f} s of silence"
            raise Late(message) if silent > armed else Failed(f"{message}: it holds another time than that")
        for valve in rig.record.valves:
            if rig.call("is_on()", device.is_on, valve.output).judged() is True:
                raise Failed(f"{valve.name} is on after the device's own vent")
        refuse_unsafe(rig, "the device's own vent", by_itself=True)
    return f"holds {armed:g} s; fed it is quiet, disarmed too; after {silent:.2f} s of silence the plant is vented"


def _arm(rig: Rig, device: Any) -> float:
    asked = rig.record.watchdog
    armed = rig.call("arm_watchdog()", device.arm_watchdog, asked).good()
    if isinstance(armed, bool) or not isinstance(armed, float | int) or not 0 < armed <= asked * 1.01:
        raise Failed(f"arm_watchdog({asked:g}) gave {armed!r}; the time that the device holds is expected [s]")
    return float(armed)


def _feed(rig: Rig, device: Any, seconds: float) -> None:
    for _ in range(round(seconds / 0.1)):
        rig.wait(0.1)
        rig.call("feed_watchdog()", device.feed_watchdog).nothing()
    if rig.logged("watchdog"):
        raise Failed("the watchdog ran out although it was fed ten times a second")


def held(rig: Rig) -> str:
    """`held` reports a watchdog that is armed, off or fired, and a restart, as the device itself says now."""
    with rig.opened(armed=False) as device:
        before = _held(rig, device)
        if issubclass(rig.driver(), Watchdog) and rig.record.watchdog:
            _reports_watchdog(rig, device, before)
    with rig.opened() as device:
        before = _held(rig, device)
        rig.pass_time(0.3)
        if reason := _difference(before, _held(rig, device)):
            raise Failed(f"held(): {reason}, and nothing happened")
        reported = ", ".join(before)
        _reports_change(rig, device, before)
        rig.restart()
        rig.wait(0.1)
        after = rig.call("held()", device.held).judged()
        if not isinstance(after, DeviceError):
            after = rig.call("held()", device.held).judged()
        if not isinstance(after, DeviceError) and not _difference(before, after):
            why = "after the emulated device was switched off and on: it answers from memory"
            raise Failed(f"held() is as before {why}")
    if rig.relays:
        _silent(rig)
    return f"{reported}; a fired or disarmed watchdog, a restart and silence are seen"


def _reports_change(rig: Rig, device: Any, before: Mapping[str, Any]) -> None:
    """Raise Failed unless `held` reports a change at the emulated device, if the emulator can make one."""
    if not getattr(rig.server, "change_held", bool)():
        return
    rig.wait(NOTICED)
    after = rig.call("held()", device.held).judged()
    if isinstance(after, DeviceError):  # an answer may be lost; an actual refusal comes again
        after = rig.call("held()", device.held).judged()
    if not isinstance(after, DeviceError) and not _difference(before, after):
        raise Failed(f"{', '.join(before)}: changed at the device, and held() is as before: it answers from memory")


def _reports_watchdog(rig: Rig, device: Any, before: Mapping[str, Any]) -> None:
    armed = rig.call("arm_watchdog()", device.arm_watchdog, rig.record.watchdog).good()
    shown = _held(rig, device).get("watchdog")
    if isinstance(shown, str | bool | None) or abs(shown - armed) > 0.01 * armed:
        raise Failed(f'arm_watchdog() gave {armed:g} s, and held() says "watchdog" is {shown!r}')
    if rig.switch_off_watchdog():
        rig.wait(NOTICED)
        after = rig.call("held()", device.held).judged()
        if not isinstance(after, DeviceError) and after.get("watchdog") == shown:
            raise Failed(f'held() says "watchdog" is {shown!r} after it was switched off at the device: it remembers')
        rig.call("arm_watchdog()", device.arm_watchdog, rig.record.watchdog).good()
    lift(rig, checked=False)
    counting = _held(rig, device)
    if getattr(rig.server, "expire_watchdog", bool)():
        rig.wait(NOTICED)
        after = rig.call("held()", device.held).judged()
        if not (isinstance(after, DeviceError) or _difference(counting, after) or _outputs_show_it(rig, device)):
            same = (
                f"held() is as before ({', '.join(after)}), and outputs and valves are read back as they were commanded"
            )
            raise Failed(f"the watchdog has fired, {same}: nothing shows that the device has vented")
        armed = rig.call("arm_watchdog()", device.arm_watchdog, rig.record.watchdog).good()
    rig.call("disarm_watchdog()", device.disarm_watchdog).nothing()
    if _held(rig, device).get("watchdog", 0) not in {0, before.get("watchdog", 0)}:
        expected = "0 is expected, or what it was before"
        raise Failed(f'held() says that the "watchdog" is on after disarm_watchdog(); {expected}')


def _outputs_show_it(rig: Rig, device: Any) -> bool:
    """Whether a fired watchdog shows in an output or a valve: some devices continue to count after firing (LabJack)."""
    for output in rig.record.outputs:
        value = rig.call("read_back()", device.read_back, output.output).judged()
        if isinstance(value, DeviceError) or not near(output, value, at(output, 0.3)):
            return True
    return any(rig.call("is_on()", device.is_on, valve.output).judged() is not True for valve in rig.record.valves)


def _held(rig: Rig, device: Any) -> Mapping[str, Any]:
    given = rig.call("held()", device.held).good()
    if not isinstance(given, Mapping) or not given:
        raise Failed(f"held() gave {given!r}; a mapping of names to numbers or texts is expected")
    for name, value in given.items():
        if not isinstance(name, str) or isinstance(value, bool) or not isinstance(value, float | int | str):
            raise Failed(f"held() gave {name!r}: {value!r}; numbers or texts by their names are expected")
    return given


def _difference(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Difference on which a guard would trip, as text; empty if none."""
    for name in {*before, *after}:
        was, now = before.get(name), after.get(name)
        if was is None or now is None or (now < was if name == "uptime" else now != was):
            return f"{name} was {was!r} and is {now!r}"
    return ""


def _silent(rig: Rig) -> None:
    with rig.opened() as device:
        _held(rig, device)
        rig.damage(silence)
        rig.wait(0.1)
        given = rig.call("held() in silence", device.held).judged()
        if not isinstance(given, DeviceError):
            raise Failed(f"held() gave {dict(given)} while the device is silent: it answers from memory")
