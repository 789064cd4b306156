"""Limits of commands to outputs and valves: pure functions of records.

An output is checked on the value that the device receives; valves that open in pulses on the duration, on the target
value, and on both valves of a muscle never being open together.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import ceil, floor, inf, isfinite

from pmabench.base.errors import LimitRefused
from pmabench.base.quantities import show
from pmabench.bench.interface import CompiledBench, OutputRecord, SafeAction, TripRecord, ValveRecord


def refuse_aims(bench: CompiledBench, aims: Mapping[str, float], most: float) -> None:
    """Raise LimitRefused if one of `aims` [SI] has no limit or lies outside it; pressures also above `most` [Pa]."""
    records = {aim.name: aim for aim in bench.aims}
    for name, value in aims.items():
        record = records.get(name)
        if record is None:
            raise LimitRefused(f'the bench has no limit for "{name}", so no valve may be opened for it')
        low, high = record.low, min(record.high, most) if record.quantity == "pressure" else record.high
        slack = 1e-9 * max(abs(low), abs(high))
        if not (isfinite(value) and low - slack <= value <= high + slack):
            shown, ends = show(value, record.quantity), [show(end, record.quantity) for end in (low, high)]
            raise LimitRefused(f"{shown} for {name} is outside {ends[0]} to {ends[1]} ({record.source})")


def refuse_pulse(valves: Mapping[str, ValveRecord], name: str, seconds: float) -> ValveRecord:
    """Valve of this name; raises LimitRefused if it does not exist, does not open in pulses, or not for `seconds`."""
    valve = valves.get(name)
    if valve is None:
        raise LimitRefused(f'the bench has no valve "{name}"')
    if not valve.longest:
        raise LimitRefused(f'"{name}" is switched and stays; it does not open in pulses')
    if not (isfinite(seconds) and 0 < seconds <= valve.longest * (1 + 1e-9)):
        raise LimitRefused(f'"{name}" cannot be opened for {seconds} s; at most {valve.longest:g} s')
    return valve


def refuse_together(pulses: Collection[str], valves: Mapping[str, ValveRecord], still: Collection[str]) -> None:
    """Raise LimitRefused if both valves of a muscle would be open; `still` are the valves that are open now."""
    for name in pulses:
        other = valves[name].never_with
        if other in pulses or other in still:
            raise LimitRefused(f'"{name}" is not opened while "{other}" is open: air would blow through')


def refuse_unsafe_pulses(bench: CompiledBench) -> None:
    """Raise LimitRefused if valves open in pulses and the bench has no other way to release the air.

    An exhaust valve cannot empty a muscle whose fill valve is stuck open: the supply is shut first, then dumps open,
    for all muscles at once, and the pressure of each is confirmed.
    """
    pulsed = {valve.name: valve for valve in bench.valves if valve.longest}
    if not pulsed:
        return
    for name, valve in pulsed.items():
        paired = pulsed.get(valve.never_with)
        if not 0 < valve.longest < inf or paired is None or paired.never_with != name:
            raise LimitRefused(f'"{name}" needs a longest time and the other valve of its muscle: it is not armed')
    confirmed = {action.target for action in bench.safe_state if action.do == "confirm"}
    for aim in bench.aims:
        if not -inf < aim.low < aim.high < inf:
            raise LimitRefused(f'the limits of "{aim.name}" make no sense: the bench is not armed')
        if aim.quantity == "pressure" and aim.name not in confirmed:
            raise LimitRefused(f"the safe state does not confirm that {aim.name} is gone: the bench is not armed")
    if not bench.together:
        raise LimitRefused("no watch compares the muscles of this bench with each other: it is not armed")
    _refuse_exhausts_alone(bench, pulsed)


def _refuse_exhausts_alone(bench: CompiledBench, pulsed: Collection[str]) -> None:
    """Raise LimitRefused unless the safe state first shuts off the supply, then opens dumps before it waits."""
    begins = []
    for action in bench.safe_state:
        if action.do not in {"open", "close", "set"}:
            break
        begins.append((action.do, action.target))
    if not begins or begins[0][0] != "close" or begins[0][1] in pulsed:
        raise LimitRefused("the safe state does not shut the supply first: the bench is not armed")
    if not any(do == "open" and target not in pulsed for do, target in begins):
        raise LimitRefused(
            "the safe state opens no dump: an exhaust valve cannot empty a muscle whose fill valve is stuck open; "
            "the bench is not armed"
        )


def refuse_unsafe_bench(bench: CompiledBench) -> None:
    """Raise LimitRefused if a bench cannot be made safe, whatever was checked before."""
    outputs = {output.name: output for output in bench.outputs}
    for output in outputs.values():
        numbers = (output.low, output.high, output.scale.slope, output.scale.offset, output.rate, output.resolution)
        sensible = _finite(*numbers) and output.scale.slope != 0 and output.rate >= 0 and output.resolution >= 0
        if not sensible or not output.low <= output.safe <= output.high or output.low >= output.high:
            raise LimitRefused(f'the limits of "{output.name}" make no sense: it is not armed')
    if not _finite(bench.setup_pressure, bench.stop_rate, bench.hands_below, bench.hands_at_pressure):
        raise LimitRefused("a pressure for setting up, for hands or for a stop is no number: the bench is not armed")
    for action in bench.safe_state:
        _refuse_senseless(action, outputs, {valve.name for valve in bench.valves})
    for trip in bench.trips:
        bounds = (bound for bound in (trip.low, trip.high) if bound is not None)
        if not _finite(*bounds, trip.delay, trip.window):
            raise LimitRefused(f'the trip limit on "{trip.channel}" is no number: it is not armed')
    watched = {trip.channel for trip in bench.trips if _ends_above(trip)}
    steered = [aim.name for aim in bench.aims if aim.quantity == "pressure"]
    if unwatched := [name for name in (*(output.name for output in bench.pressures), *steered) if name not in watched]:
        raise LimitRefused(f"the bench has no trip limit on {unwatched[0]} that ends a run: it is not armed")
    refuse_unsafe_pulses(bench)


def _refuse_senseless(action: SafeAction, outputs: Mapping[str, OutputRecord], valves: Collection[str]) -> None:
    known = action.do in {"hold", "confirm"} or action.target in (valves if action.do in {"open", "close"} else outputs)
    timed = _finite(action.value, action.within, action.rate) and (action.do != "ramp" or action.rate > 0)
    if not known or not timed:
        raise LimitRefused(f'the safe state\'s "{action.do} {action.target}" makes no sense: it is not armed')
    if action.do in {"set", "ramp"} and not outputs[action.target].low <= action.value <= outputs[action.target].high:
        raise LimitRefused(f'the safe state sends "{action.target}" beyond its limits: it is not armed')


def _finite(*numbers: float) -> bool:
    return all(isfinite(number) for number in numbers)


def _ends_above(trip: TripRecord) -> bool:
    return trip.kind == "range" and trip.high is not None and trip.action in {"stop", "vent"}


def to_device(output: OutputRecord, value: float) -> float:
    """Value in device units, rounded to the resolution: in SI towards the safe value, and down at the safe value."""
    raw = float(output.scale.to_raw(value))
    if output.resolution == 0:
        return raw
    steps = raw / output.resolution
    near = round(steps)
    if abs(steps - near) < 1e-6:
        return near * output.resolution
    lower_si = value >= output.safe
    upwards = lower_si == (output.scale.slope < 0)
    return (ceil(steps) if upwards else floor(steps)) * output.resolution


def refuse_outside(output: OutputRecord, values: tuple[float, ...], most: float) -> None:
    """Raise LimitRefused if one of `values` [SI], or what the device would make of it, is outside the limits.

    `most` [SI] is a second upper limit: that of the set-up before the bench is proven.
    """
    for value in values:
        if not isfinite(value):
            raise LimitRefused(f'"{output.name}" is never commanded to {value}')
        slack = 1e-9 * max(abs(output.low), abs(output.high))
        step = abs(output.resolution * output.scale.slope)
        sent = output.scale.to_si(to_device(output, value))
        asked_inside = output.low - slack <= value <= output.high + slack
        if not asked_inside or not output.low - step - slack <= sent <= output.high + slack:
            low, high = show(output.low, output.quantity), show(output.high, output.quantity)
            shown = show(value, output.quantity)
            raise LimitRefused(
                f"{shown} for {output.name} is outside {low} ({output.low_from}) to {high} ({output.high_from})"
            )
        if value > most + slack:
            shown, bound = show(value, output.quantity), show(most, output.quantity)
            raise LimitRefused(f"{shown} for {output.name} is above {bound}: the bench is not proven yet")


def refuse_jump(output: OutputRecord, now: float, origin: float) -> None:
    """Raise LimitRefused if an output with a rate limit would start away from its commanded value `now` [SI]."""
    room = 1e-3 * (output.high - output.low) + abs(output.resolution * output.scale.slope)
    if output.rate and abs(origin - now) > room:
        where, shown = show(now, output.quantity), show(origin, output.quantity)
        raise LimitRefused(f'"{output.name}" is at {where} and cannot jump to {shown}')
