"""What an output may be commanded to: looked at on the value that the device really gets. Pure functions of records."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import ceil, floor, isfinite

from pmabench.base.errors import LimitRefused
from pmabench.base.quantities import show
from pmabench.bench.interface import CompiledBench, OutputRecord, SafeAction, TripRecord
from pmabench.guard.pulses import refuse_unsafe_pulses


def refuse_unsafe_bench(bench: CompiledBench) -> None:
    """Raise LimitRefused where a bench cannot be made safe, whatever was checked before."""
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
    """Device units, rounded to the resolution towards the safe value, and at the safe value downwards [SI]."""
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
    """Raise LimitRefused where one of `values` [SI], or what the device would make of it, is outside the limits.

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
    """An output with a highest rate starts a motion at its commanded value `now` [SI]."""
    room = 1e-3 * (output.high - output.low) + abs(output.resolution * output.scale.slope)
    if output.rate and abs(origin - now) > room:
        where, shown = show(now, output.quantity), show(origin, output.quantity)
        raise LimitRefused(f'"{output.name}" is at {where} and cannot jump to {shown}')
