"""Checks of the device's own watchdog, and of what a driver reports that its device holds (promise S11)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Supervised, Watchdog
from pmabench.conformance.commands import at, lift, near, reaches, refuse_unsafe
from pmabench.conformance.damage import silence
from pmabench.conformance.rig import CALLS_WITHIN, Rig
from pmabench.conformance.verdict import Failed, Late, NotApplicable, NotChecked

EARLY, LATE = 0.1, 0.25
"""How much before and after its time a watchdog may act [s]."""
NOTICED = 0.5
"""So soon a difference must be in `held` [s]."""


def watchdog(rig: Rig) -> str:
    """Armed, it says the time that the device holds; fed, it is quiet; without that the device vents at that time."""
    if not rig.record.watchdog or not issubclass(rig.driver(), Watchdog):
        raise NotApplicable("the bench file gives it no watchdog")
    asked = rig.record.watchdog
    truth = rig.truth()
    with rig.opened(armed=False) as device:
        armed = _arm(rig, device)
        lift(rig, truth)
        _feed(rig, device, 1.5 * asked)
        rig.call("disarm_watchdog()", device.disarm_watchdog).nothing(CALLS_WITHIN)
        rig.bench_clock.wait_until(rig.bench_clock.now() + asked + LATE)
        noted: list[Any] = rig.logged("watchdog")
        if rig.emulator is None:  # it writes nothing down: an output that is no longer up says so
            regulated = [output for output in rig.record.outputs if output.quantity == "pressure"]
            noted = [output for output in regulated if not reaches(rig, truth, output, at(output, 0.3))]
        if noted:
            raise Failed(f"the device vented {asked:g} s after disarm_watchdog()")
        armed = _arm(rig, device)
        lift(rig, truth)
        _feed(rig, device, 0.3)
        rig.bench_clock.wait_until(rig.bench_clock.now() + armed + LATE + 0.25)
        fired = rig.logged("watchdog")
        if rig.emulator is not None and not fired:
            raise Failed(f"the emulated device did nothing {armed + LATE:g} s after it was fed last")
        silent = fired[0].get("silent", armed) if fired else armed
        if not armed - EARLY <= silent <= armed + LATE:
            message = f"arm_watchdog({asked:g}) gave {armed:g} s, and the device vented after {silent:.2f} s of silence"
            raise Late(message) if silent > armed else Failed(f"{message}: it holds another time than that")
        for valve in rig.record.valves:
            if rig.call("is_on()", device.is_on, valve.output).judged(CALLS_WITHIN) is True:
                raise Failed(f"{valve.name} is on after the device's own vent")
        refuse_unsafe(rig, truth, "the device's own vent", by_itself=True)
    return f"holds {armed:g} s; fed it is quiet, disarmed too; after {silent:.2f} s of silence the plant is vented"


def _arm(rig: Rig, device: Any) -> float:
    asked = rig.record.watchdog
    armed = rig.call("arm_watchdog()", device.arm_watchdog, asked).good(CALLS_WITHIN)
    if isinstance(armed, bool) or not isinstance(armed, float | int) or not 0 < armed <= asked * 1.01:
        raise Failed(f"arm_watchdog({asked:g}) gave {armed!r}; the time that the device holds is expected [s]")
    return float(armed)


def _feed(rig: Rig, device: Any, seconds: float) -> None:
    for _ in range(round(seconds / 0.1)):
        rig.bench_clock.wait_until(rig.bench_clock.now() + 0.1)
        rig.call("feed_watchdog()", device.feed_watchdog).nothing(CALLS_WITHIN)
    if rig.logged("watchdog"):
        raise Failed("the watchdog ran out although it was fed ten times a second")


def held(rig: Rig) -> str:
    """`held` reports a watchdog that is armed, off or fired, and a restart, as the device itself says now."""
    if not issubclass(rig.driver(), Supervised):
        raise NotApplicable("it has no held(): that its device restarts is not seen while it is pressurised")
    with rig.opened(armed=False) as device:
        before = _held(rig, device)
        if issubclass(rig.driver(), Watchdog) and rig.record.watchdog:
            _reports_watchdog(rig, device, before)
    with rig.opened() as device:
        before = _held(rig, device)
        rig.pass_time(0.3)
        if reason := _difference(before, _held(rig, device)):
            raise Failed(f"held(): {reason}, and nothing happened")
        reported = _entries(before)
        _reports_change(rig, device, before)
        if not rig.restart():
            raise NotChecked(f"{reported}; a restart: there is no emulator that could be switched off and on")
        rig.bench_clock.wait_until(rig.bench_clock.now() + 0.1)
        after = rig.call("held()", device.held).judged(CALLS_WITHIN)
        if not isinstance(after, DeviceError):
            after = rig.call("held()", device.held).judged(CALLS_WITHIN)
        if not isinstance(after, DeviceError) and not _difference(before, after):
            raise Failed(
                "held() is as before after the emulated device was switched off and on: it answers from memory"
            )
    if rig.relays:
        _silent(rig)
    return f"{reported}; a fired or disarmed watchdog, a restart and silence are seen"


def _reports_change(rig: Rig, device: Any, before: Mapping[str, Any]) -> None:
    """What is changed at the emulated device itself is reported, where the emulator can change it."""
    if not getattr(rig.server, "change_held", bool)():
        return
    rig.bench_clock.wait_until(rig.bench_clock.now() + NOTICED)
    after = rig.call("held()", device.held).judged(CALLS_WITHIN)
    if isinstance(after, DeviceError):  # an answer may be lost; what is refused is refused again
        after = rig.call("held()", device.held).judged(CALLS_WITHIN)
    if not isinstance(after, DeviceError) and not _difference(before, after):
        raise Failed(f"{_entries(before)}: changed at the device, and held() is as before: it answers from memory")


def _reports_watchdog(rig: Rig, device: Any, before: Mapping[str, Any]) -> None:
    armed = rig.call("arm_watchdog()", device.arm_watchdog, rig.record.watchdog).good(CALLS_WITHIN)
    shown = _held(rig, device).get("watchdog")
    if isinstance(shown, str | bool | None) or abs(shown - armed) > 0.01 * armed:
        raise Failed(f'arm_watchdog() gave {armed:g} s, and held() says "watchdog" is {shown!r}')
    if rig.switch_off_watchdog():
        rig.bench_clock.wait_until(rig.bench_clock.now() + NOTICED)
        after = rig.call("held()", device.held).judged(CALLS_WITHIN)
        if not isinstance(after, DeviceError) and after.get("watchdog") == shown:
            raise Failed(f'held() says "watchdog" is {shown!r} after it was switched off at the device: it remembers')
        rig.call("arm_watchdog()", device.arm_watchdog, rig.record.watchdog).good(CALLS_WITHIN)
    lift(rig)
    counting = _held(rig, device)
    if getattr(rig.server, "expire_watchdog", bool)():
        rig.bench_clock.wait_until(rig.bench_clock.now() + NOTICED)
        after = rig.call("held()", device.held).judged(CALLS_WITHIN)
        if not (isinstance(after, DeviceError) or _difference(counting, after) or _outputs_show_it(rig, device)):
            raise Failed(
                f"the watchdog has fired, held() is as before ({_entries(after)}), and outputs and valves are read "
                "back as they were commanded: nothing shows that the device has vented"
            )
        armed = rig.call("arm_watchdog()", device.arm_watchdog, rig.record.watchdog).good(CALLS_WITHIN)
    rig.call("disarm_watchdog()", device.disarm_watchdog).nothing(CALLS_WITHIN)
    if _held(rig, device).get("watchdog", 0) not in {0, before.get("watchdog", 0)}:
        raise Failed(
            'held() says that the "watchdog" is on after disarm_watchdog(); 0 is expected, or what it was before'
        )


def _outputs_show_it(rig: Rig, device: Any) -> bool:
    """Whether a fired watchdog shows in an output or a valve: some devices go on counting by themselves (LabJack)."""
    for output in rig.record.outputs:
        value = rig.call("read_back()", device.read_back, output.output).judged(CALLS_WITHIN)
        if isinstance(value, DeviceError) or not near(output, value, at(output, 0.3)):
            return True
    for valve in rig.record.valves:
        if rig.call("is_on()", device.is_on, valve.output).judged(CALLS_WITHIN) is not True:
            return True
    return False


def _held(rig: Rig, device: Any) -> Mapping[str, Any]:
    given = rig.call("held()", device.held).good(CALLS_WITHIN)
    if not isinstance(given, Mapping) or not given:
        raise Failed(f"held() gave {given!r}; a mapping of names to numbers or texts is expected")
    for name, value in given.items():
        if not isinstance(name, str) or isinstance(value, bool) or not isinstance(value, float | int | str):
            raise Failed(f"held() gave {name!r}: {value!r}; numbers or texts by their names are expected")
    return given


def _difference(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """What a guard would trip on; empty: nothing."""
    for name in {*before, *after}:
        was, now = before.get(name), after.get(name)
        if was is None or now is None or (now < was if name == "uptime" else now != was):
            return f"{name} was {was!r} and is {now!r}"
    return ""


def _entries(found: Mapping[str, Any]) -> str:
    return ", ".join(found)


def _silent(rig: Rig) -> None:
    with rig.opened() as device:
        _held(rig, device)
        rig.damage(silence)
        rig.bench_clock.wait_until(rig.bench_clock.now() + 0.1)
        given = rig.call("held() in silence", device.held).judged(CALLS_WITHIN)
        if not isinstance(given, DeviceError):
            raise Failed(f"held() gave {dict(given)} while the device is silent: it answers from memory")
