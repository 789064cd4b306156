"""Lines of the self-test's table, checks of a bench at rest, and the refusal that names the fault; no devices.

Also which wire, or which swapped pair, explains the broken claims. The wire that all broken claims share is at fault,
unless a good, exact claim depends on it and another wire is left. A swap is reported if exchanging two readings
makes every claim good, by evidence from both readings.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from pmabench.base.errors import VerdictFailed
from pmabench.base.quantities import show
from pmabench.bench.compile import Mounted
from pmabench.bench.interface import ChannelRecord
from pmabench.bench.safety import SUPPLY_MARGIN
from pmabench.session.guided import Series
from pmabench.session.wiring import (
    AIR,
    DISPLACEMENT,
    EXPECTED,
    FLIPPED,
    FORCE,
    HOSE,
    LEAD,
    MOVE,
    OUT,
    PLACE,
    PLATES,
    PRESSURE,
    SCALE,
    SET,
    STILL,
    WRONG,
    Claim,
    Stage,
    Wiring,
)  # fmt: skip

OK, FAILED, NOT_MEASURED, NOT_CHECKED = "ok", "failed", "not measured", "not checked"


@dataclass(frozen=True)
class Check:
    """What was checked, the result and its limit; `hint` states where to look if it failed."""

    name: str
    value: str
    limit: str = ""
    verdict: str = OK
    hint: str = ""


class SelfTestFailed(VerdictFailed):
    """The bench is not fit for a run."""


def judged(name: str, value: str, limit: str, *, good: bool, hint: str) -> Check:
    """A check with its verdict."""
    return Check(name, value, limit, OK if good else FAILED, "" if good else hint)


def refuse(checks: Sequence[Check]) -> None:
    """Raise SelfTestFailed with every hint if a check has failed."""
    failed = [check for check in checks if check.verdict == FAILED]
    if failed:
        reasons = "; ".join(f"{check.name} {check.value}: {check.hint}" for check in failed)
        raise SelfTestFailed(f"the self-test failed: {reasons}")


def at_rest(mounted: Mounted, series: Mapping[str, Series], noise: Mapping[str, float]) -> list[Check]:
    """Checks of a vented bench that need no reference; `noise` [SI] is the limit of each channel."""
    channels = {channel.name: channel for channel in mounted.bench.channels}
    checks = [check for name, one in series.items() for check in _noise(channels[name], one, noise)]
    return [*checks, *_supply(mounted, series)]


def _noise(channel: ChannelRecord, series: Series, limits: Mapping[str, float]) -> Iterator[Check]:
    name, quantity = channel.name, channel.quantity
    if name.endswith("_command"):
        return
    noise, limit = series.reading().noise, limits[name]
    resolution = abs(channel.scale.slope) if channel.raw_type == "int32" else 0.0
    step = f", resolution {show(resolution, quantity, 2)}" if resolution else ""
    yield judged(
        f"noise of {name}",
        f"{show(noise, quantity, 3)} rms{step}",
        f"at most {show(limit, quantity, 3)}",
        good=noise <= limit,
        hint=f"look at shield and ground of the wire to {channel.device}.{channel.input}",
    )


def _supply(mounted: Mounted, series: Mapping[str, Series]) -> Iterator[Check]:
    highest = max((output.high for output in mounted.bench.outputs if output.quantity == "pressure"), default=None)
    if highest is None:
        return
    if "supply" not in series:
        yield Check("supply at rest", "", "", NOT_MEASURED, "no channel for it on this bench")
        return
    least, mean = highest + SUPPLY_MARGIN, series["supply"].mean()
    yield judged(
        "supply at rest",
        show(mean, "pressure", 4),
        f"at least {show(least, 'pressure', 4)}",
        good=mean >= least,
        hint=f"it must be {show(SUPPLY_MARGIN, 'pressure')} above the highest set-point: look at the supply, its valve "
        "and filter, or at the wire of its sensor",
    )


PLUGS = (PRESSURE, FORCE, DISPLACEMENT, SET, PLACE, "supply")
"""Channels whose plugs may be swapped."""
WORDS = {
    AIR: "the air: a leak, too little supply or a regulator that does not follow",
    HOSE: "the hose to the muscle, or a free end that is held",
    PLATES: "the plates (is the whole load on the free end, and no more?)",
    EXPECTED: "`expected` of the specimen file",
}
KINDS = {
    FLIPPED: ("the sign of {} is wrong (its two wires, or the ends of its calibration)", "a sign is wrong"),
    SCALE: ("the scale of {} is wrong: look at its range and at its calibration", "numbers disagree"),
    STILL: ("{} does not answer: look at its wire and its power", "something does not answer"),
    WRONG: ("look at the wire of {}, at its range and at its calibration", "a wire, a range or a calibration is wrong"),
}
"""Kind of broken claim -> a cause in words, and its first words if several wires could be at fault."""
REFERENCES = {
    "scale of force": (("load cell", "force as expected"), "no weight hung, and nothing is expected of it"),
    "scale of displacement": (
        ("contraction as expected", "displacement driven"),
        "no drive moves the free end, and nothing is expected of the specimen",
    ),
    "output or scale of pressure": (
        ("read-back of the set-point",),
        "no channel reads the set-point back, so which of them were wrong could not be decided",
    ),
}
"""Quantity -> rows of which one must have been tested, and the reason why there is no reference."""


@dataclass(frozen=True)
class Cause:
    """Wires and swapped pairs, each of which would explain all broken claims; empty if no single one does."""

    wires: tuple[str, ...]
    swaps: tuple[tuple[str, str], ...]
    kind: str


def cause_of(wiring: Wiring, stages: Sequence[Stage]) -> Cause | None:
    """What explains the broken claims of the stages; None if none is broken."""
    claims = wiring.claims(stages)
    broken = [claim for claim in claims if not claim.good]
    if not broken:
        return None
    kinds = {claim.kind for claim in broken}
    kind = next((kind for kind in (FLIPPED, WRONG, STILL) if kind in kinds), SCALE)
    shared = [wire for wire in broken[0].wires if all(wire in claim.wires for claim in broken)]
    where = {claim.stage for claim in broken}
    cleared = {wire for claim in claims if claim.good and claim.exact and claim.stage in where for wire in claim.wires}
    wires = tuple(wire for wire in shared if wire not in cleared) or tuple(shared)
    found = {pair: _swapped(wiring, stages, broken, pair) for pair in _pairs(wiring)}
    swaps = {pair: sure for pair, sure in found.items() if sure is not None}
    certain = tuple(pair for pair, sure in swaps.items() if sure)
    if certain:
        return Cause((), certain, WRONG)
    return Cause(wires, tuple(swaps), kind)


def _pairs(wiring: Wiring) -> Iterator[tuple[str, str]]:
    """Pairs of channels whose plugs fit each other: their devices give the same unit."""
    channels = wiring.channels
    for one, other in combinations([name for name in PLUGS if name in channels], 2):
        here, there = channels[one], channels[other]
        if (here.raw_unit, here.raw_type) == (there.raw_unit, there.raw_type):
            yield one, other


def _swapped(wiring: Wiring, stages: Sequence[Stage], broken: Sequence[Claim], pair: tuple[str, str]) -> bool | None:
    """Whether exchanging two readings makes all claims good: True; False with weak evidence only; None if not."""
    concerned = [name for name in pair if any(name in claim.wires for claim in broken)]
    crossed = wiring.claims(stages, pair)
    if not concerned or not all(claim.good for claim in crossed):
        return None
    rows = {claim.row for claim in broken if claim.exact or claim.row == LEAD}
    alone = any(all(name in claim.wires for claim in broken) for name in pair)
    if any(claim.row in rows for claim in crossed) or (len(concerned) == 2 and not alone):
        return True
    return False if len(stages) == 1 else None


def words(wiring: Wiring, cause: Cause) -> str:
    """What to look at, as a sentence."""
    plugs = [f"the plugs of {one} and {other}" for one, other in cause.swaps]
    swaps = [f"{text}, swapped ({wiring.input(*pair)})" for text, pair in zip(plugs, cause.swaps, strict=True)]
    named = [_named(wiring, wire) for wire in cause.wires]
    if len(swaps) == 1 and not named:
        return f"{plugs[0]} are swapped ({wiring.input(*cause.swaps[0])})"
    if len(named) == 1 and not swaps:
        if cause.wires[0] in WORDS:
            return f"look at {named[0]}"
        if wiring.dump is not None and cause.wires[0] == wiring.dump.name:
            return f"{named[0]} has no effect, or the opposite one: look at its wire, and at its `energised`"
        return KINDS[cause.kind][0].format(named[0])
    if not swaps and not named:
        return "no single wire explains all that is wrong"
    *first, last = *named, *swaps
    then = "; look at the plates first, then at the sensor, its range and its calibration"
    undecided = f"{KINDS[cause.kind][1]}; undecided between {', '.join(first)} and {last}"
    return undecided + (then if PLATES in cause.wires else "")


def _named(wiring: Wiring, wire: str) -> str:
    """A channel, an output, a valve or another cause, with its terminal."""
    if wire in WORDS:
        return WORDS[wire]
    if wiring.dump is not None and wire == wiring.dump.name:
        return f"the valve {wire} ({wiring.dump.device}.{wiring.dump.output})"
    if wire in {OUT, MOVE}:
        name = wire.removeprefix("set ")
        return f"the output {name} ({wiring.output(name)})"
    return f"the {wire} ({wiring.input(wire)})"


def table(wiring: Wiring, stages: Sequence[Stage]) -> list[Check]:
    """One line per row of claims: its first broken claim, else the last one; the first broken line names the cause."""
    rows: dict[str, Claim] = {}
    for claim in wiring.claims(stages):
        if claim.row not in rows or rows[claim.row].good:
            rows[claim.row] = claim
    cause = cause_of(wiring, stages)
    said = words(wiring, cause) if cause is not None else ""
    checks = []
    for row, claim in rows.items():
        hint = "" if claim.good else said
        if not claim.good and cause is not None and not cause.wires and not cause.swaps:
            hint = words(wiring, Cause(claim.wires, (), claim.kind))
        elif not claim.good:
            said = "explained by the same"
        checks.append(Check(row, claim.value, claim.limit, OK if claim.good else FAILED, hint))
    return checks


def unchecked(wiring: Wiring, stages: Sequence[Stage]) -> Iterator[Check]:
    """What a self-test with good claims only could not check, for lack of an independent reference."""
    tried = [claim.row for claim in wiring.claims(stages)]
    for name, (rows, why) in REFERENCES.items():
        if name.split()[-1] in wiring.channels and not any(row.startswith(rows) for row in tried):
            yield Check(name, "", "", NOT_CHECKED, f"no independent reference: {why}")
    for one, other in _pairs(wiring):
        crossed = wiring.claims(stages, (one, other)) if {one, other} <= set(stages[0].means) else []
        if crossed and all(claim.good for claim in crossed):
            why = "no independent reference: exchanged they would read the same"
            yield Check(f"plugs of {one} and {other}", "", "", NOT_CHECKED, why)
