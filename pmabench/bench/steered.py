"""Muscles that valves fill and empty in pulses: limits of what is brought about, and what such a bench cannot lack.

An exhaust valve does not empty a muscle whose fill valve is stuck open (5.2 of 7 bar remain). So the supply is shut
first, then dumps that are open without power empty all muscles at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from pmabench.base.quantities import show
from pmabench.bench.compilation import Compilation
from pmabench.bench.interface import AimRecord, SafeAction, ValveRecord
from pmabench.files.document import Location

SUPPLY_VALVE = "supply_valve"
LONGEST_PULSE = 0.1
"""A valve that opens for longer [s] would bring a muscle from nothing to its limit in one pulse."""
PLATFORM_MUSCLES = 3
MEASURED = ("acceleration_x", "acceleration_y", "acceleration_z")
COUNTERPART = {"fill": "exhaust", "exhaust": "fill"}


def paired(c: Compilation, name: str, valve: ValveRecord) -> ValveRecord:
    """The record of a valve with its longest pulse and its counterpart, where it opens in pulses."""
    pulse, at = c.bench.valves[name].pulse, ("outputs", name)
    kind, _, number = name.partition("_")
    if pulse is None:
        return valve
    if kind not in COUNTERPART or number not in c.bench.muscles or c.bench.platform is None:
        c.fault(at, 'opens in pulses, and only "fill_1", "exhaust_1" and so on of a platform can', key=True)
    if pulse > LONGEST_PULSE:
        c.fault((*at, "pulse"), f"is longer than {show(LONGEST_PULSE, 'time')}")
    if valve.energised != "open":
        c.fault((*at, "energised"), "a valve that opens in pulses is open while it is energised")
    return replace(valve, longest=pulse, never_with=f"{COUNTERPART.get(kind, kind)}_{number}", safe="closed")


def aims(c: Compilation) -> tuple[AimRecord, ...]:
    """Limits of each pressure and of the tilt, and every problem of a bench whose valves open in pulses."""
    platform = c.bench.platform
    if platform is None:
        return ()
    if len(c.bench.muscles) != PLATFORM_MUSCLES:
        c.fault(("platform",), f"a platform has {PLATFORM_MUSCLES} muscles, not {len(c.bench.muscles)}", key=True)
    for name in MEASURED:
        if name not in c.bench.channels:
            c.fault(("channels",), f'nothing measures the attitude: add a channel "{name}" of the accelerometer')
    _refuse_without_valves(c)
    tilt = AimRecord("tilt", "angle", 0.0, platform.tilt, c.place("platform", "tilt"))
    return (*(aim for name in c.bench.steered if (aim := _pressure(c, name)) is not None), tilt)


def _pressure(c: Compilation, name: str) -> AimRecord | None:
    """What one muscle may be brought to: the limits of bench, muscle and specimen."""
    limit, at = c.bench.limits.get(name), ("limits", name)
    if limit is None or limit.command is None or limit.command_low is None:
        c.fault(at, f'lacks a limit of what valves may bring about; add "{name}: {{command_low: ..., command: ...}}"')
        return None
    low = c.si(limit.command_low, "pressure", (*at, "command_low"))
    highs = [(c.si(limit.command, "pressure", (*at, "command")), c.place(*at, "command"))]
    highs += [(borne.limits.pressure.command, borne.place("pressure", "command")) for borne in c.borne(name)]
    high, source = min(highs)
    channel = c.channels.get(name)
    if not 0 <= low < high:
        c.fault((*at, "command_low"), f"must be at least 0 and below {show(high, 'pressure')} ({source})")
    elif limit.trip is not None and channel is not None:
        trip = c.si(limit.trip, "pressure", (*at, "trip"))
        margin = channel.calibration.uncertainty(trip) + c.bench.air.overshoot
        if trip < high + margin * (1 - 1e-9):
            least = f"{show(margin, 'pressure')} (uncertainty and overshoot) above {show(high, 'pressure')} ({source})"
            c.fault((*at, "trip"), f"the trip {show(trip, 'pressure')} must lie at least {least}")
    return AimRecord(name, "pressure", low, high, source)


def _refuse_without_valves(c: Compilation) -> None:
    """Two valves of each muscle that open in pulses, a shut-off of the supply, and dumps that open without power."""
    valves: Mapping[str, ValveRecord] = c.valves
    for number in c.bench.muscles:
        for kind in COUNTERPART:
            name = f"{kind}_{number}"
            if name not in valves or not valves[name].longest:
                what = (
                    f'lacks the valve "{name}" that opens in pulses; add it with "energised: open" and "pulse: 20 ms"'
                )
                c.fault(("outputs", name) if name in valves else ("outputs",), what)
    if SUPPLY_VALVE not in valves or valves[SUPPLY_VALVE].energised != "open":
        c.fault(
            ("outputs", SUPPLY_VALVE) if SUPPLY_VALVE in valves else ("outputs",),
            f'lacks "{SUPPLY_VALVE}", which shuts the air off before the fill valves without power (energised: open): '
            "a muscle whose fill valve is stuck open cannot be emptied while the supply is on",
        )
    if not c.bench.switched_dump:
        c.fault(
            ("outputs",),
            'lacks dumps: "dump_valve" for all muscles, or "dump_valve_1" and so on, open without power (energised: '
            "closed) and four times as wide as a fill valve; an exhaust valve cannot empty a muscle whose fill valve "
            "is stuck open",
        )


def refuse_unsafe_order(c: Compilation, actions: tuple[SafeAction, ...]) -> None:
    """A problem where the safe state does not shut the supply first, open every dump at once, and look at the end."""
    at: Location = ("safe_state",)
    if not actions or (actions[0].do, actions[0].target) != ("close", SUPPLY_VALVE):
        c.fault((*at, 0), f'the supply is shut first: "- {{close: {SUPPLY_VALVE}, within: ...}}"')
    begins = list(_before_any_wait(actions))
    for name in c.valves:
        if name.startswith("dump_valve") and ("open", name) not in begins:
            c.fault(at, f'opens "{name}" too late or never: it comes before anything that is waited for')
    for name in c.bench.steered:
        if not any(action.do == "confirm" and action.target == name for action in actions):
            c.fault(at, f'does not look: "- {{confirm: {name}, below: ..., within: ...}}" is missing')
    if c.bench.vents != "together":
        c.fault(("vents",), 'a platform vents all muscles "together": one alone would turn it with all that it has')


def _before_any_wait(actions: tuple[SafeAction, ...]) -> Iterator[tuple[str, str]]:
    for action in actions:
        if action.do not in {"open", "close"}:
            return
        yield action.do, action.target


def numbers(c: Compilation) -> dict[str, float]:
    """What the control of the platform must know of it, in SI, by the names of `model.many.platform.described`."""
    platform, air = c.bench.platform, c.bench.air
    if platform is None:
        return {}
    given = platform.model_dump(exclude={"tilt"})
    found = {**given, "supply": air.supply, "atmosphere": air.atmosphere}
    if c.specimen_document is not None:
        angle = c.specimen.braid_angle
        found |= {"diameter": c.specimen.inner_diameter, "length": c.specimen.mounted.length}
        found |= {} if angle is None else {"braid_angle": angle}
    return found
