"""What valves that open in pulses may do: for how long, at what they aim, never both of a muscle; pure functions."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import inf, isfinite

from pmabench.base.errors import LimitRefused
from pmabench.base.quantities import show
from pmabench.bench.interface import CompiledBench, ValveRecord


def refuse_aims(bench: CompiledBench, aims: Mapping[str, float], most: float) -> None:
    """Raise LimitRefused where one of `aims` [SI] has no limit or lies outside it; `most` [Pa] bounds pressures too."""
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
    """The valve of this name; LimitRefused where it does not open in pulses, or not for so long [s]."""
    valve = valves.get(name)
    if valve is None:
        raise LimitRefused(f'the bench has no valve "{name}"')
    if not valve.longest:
        raise LimitRefused(f'"{name}" is switched and stays; it does not open in pulses')
    if not (isfinite(seconds) and 0 < seconds <= valve.longest * (1 + 1e-9)):
        raise LimitRefused(f'"{name}" cannot be opened for {seconds} s; at most {valve.longest:g} s')
    return valve


def refuse_together(pulses: Collection[str], valves: Mapping[str, ValveRecord], still: Collection[str]) -> None:
    """Raise LimitRefused where both valves of a muscle would be open; `still` are those that are open now."""
    for name in pulses:
        other = valves[name].never_with
        if other in pulses or other in still:
            raise LimitRefused(f'"{name}" is not opened while "{other}" is open: air would blow through')


def refuse_unsafe_pulses(bench: CompiledBench) -> None:
    """Raise LimitRefused where valves open in pulses and the bench has no other way to take the air off.

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
    """The safe state begins with a shut-off of the supply, and opens dumps before it waits for anything."""
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
