"""What the readings of a correct bench satisfy: the table of claims behind the self-test; pure, no devices.

A claim relates a reading to a reference that does not come from it (zero gauge pressure when vented, a weight, a
command, another channel, the specimen file) and names the wires that it depends on. `checks.cause_of` uses them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from pmabench.base.quantities import show
from pmabench.bench.compile import Mounted
from pmabench.bench.files.specimen import ExpectedFile
from pmabench.protocol.driven import believed

SHARE = 0.02
"""Largest accepted reading at rest, as a fraction of the range, if the bench file has no limit for the zero."""
PRELOAD = 0.04
"""Largest accepted force without pressure, as a fraction of the range, if the load cannot be taken off."""
RESTS = (-4e-3, 8e-3)
"""Range of an unpressurised free end [m]: friction holds a muscle up to 5 mm short; the rest allows for the zero."""
MOVED = 0.5e-3
"""Displacement that counts as a motion [m]."""
LIFTED = 2 * MOVED
"""Displacement from which a load counts as hanging [m]."""
FRICTION = 5.0
"""Friction of guides and pulley that may add to a load at rest [N]."""
SIGNIFICANT = 5.0
"""Multiple of the rms noise from which a change counts."""
ROUGH = 1.4
"""Factor by which a muscle may differ from its specimen file."""
DRIVE = (0.05, 0.3e-3)
"""Allowed deviation of a drive: fraction of the travel, plus a constant [m]."""
CONTRACTS = 0.3
"""Contraction that no muscle reaches, as a fraction of its length."""
LEADS = 0.02
"""Largest time by which the pressure may pass its half-way point before the command's read-back does [s]."""
PRESSURE, FORCE, DISPLACEMENT = "pressure", "force", "displacement"
SET, PLACE = "pressure_command", "displacement_command"
OUT, MOVE = "set pressure", "set displacement"
AIR, HOSE, PLATES, EXPECTED = "air", "hose", "plates", "expected"
"""Causes other than wires that a claim may depend on."""
FLIPPED, WRONG, SCALE, STILL = "sign", "wire", "scale", "still"
"""Kinds of broken claims."""
FOLLOWS, LEAD = "pressure follows its command", "pressure after its command"
"""Names of rows that other modules refer to."""


@dataclass(frozen=True)
class Stage:
    """Reading of every channel [SI, by the bench file] at the end of a hold, with its conditions."""

    means: Mapping[str, float]
    pressure: float = 0.0
    """Commanded pressure [Pa]."""
    load: float | None = None
    """Weight on the free end [N]; None: not known."""
    place: float | None = None
    """Commanded position of the drive [m]; None: not moved yet."""
    halves: Mapping[str, float] = field(default_factory=dict)
    """When a channel passed half of its change to this stage [s, bench time]."""
    settled: bool = True
    """False: the hold ended early."""
    tripped: str = ""
    """The channel whose limit ended it; else empty."""
    drift: float = 0.0
    """Change of the pressure in the last fifth of the hold [Pa]."""
    opened: str = ""
    """The valve that was opened under this pressure; else empty."""


@dataclass(frozen=True)
class Claim:
    """A relation that holds on a correct bench: its row of the table, and the wires and causes that it depends on."""

    row: str
    wires: tuple[str, ...]
    good: bool
    value: str
    limit: str
    kind: str = SCALE
    exact: bool = False
    """Whether it compares two numbers that no wrong wire makes equal by chance."""
    stage: int = -1
    """Index of its stage."""


class Wiring:
    """The claims of one bench; `noise` [SI] is the rms of a channel at rest."""

    def __init__(self, mounted: Mounted, noise: Mapping[str, float] | None = None) -> None:
        bench, test = mounted.bench, mounted.session.self_test if mounted.session is not None else None
        self.mounted, self.noise = mounted, dict(noise or {})
        self.channels = {channel.name: channel for channel in bench.channels}
        self.outputs = {output.name: output for output in bench.outputs}
        self.top = max(test.points) if test is not None else bench.setup_pressure
        self._linearity = test.linearity if test is not None else 0.05
        self.dump = next((valve for valve in bench.valves if valve.safe == "open"), None)
        self.driven = bench.free_end == "actuator"

    def input(self, *names: str) -> str:
        """Inputs of channels as device.input."""
        return " and ".join(f"{self.channels[name].device}.{self.channels[name].input}" for name in names)

    def output(self, name: str) -> str:
        """An output as device.output."""
        return f"{self.outputs[name].device}.{self.outputs[name].output}"

    def zero_limit(self, name: str) -> float:
        """Largest accepted reading of a vented, unloaded channel [SI]."""
        session, channel = self.mounted.session, self.channels[name]
        zero = session.zeros.get(name) if session is not None else None
        if zero is not None:
            return zero.most
        return (PRELOAD if name == FORCE and self.driven else SHARE) * (channel.high - channel.low)

    def follows_within(self) -> float:
        """Allowed deviation of the pressure from its command [Pa]."""
        unknown = [
            self.channels[name].calibration.offset_uncertainty for name in (PRESSURE, SET) if name in self.channels
        ]
        return self._linearity * self.top + max(unknown, default=0.0)

    # -- the table ------------------------------------------------------------------------------------------------

    def claims(self, stages: Sequence[Stage], swap: tuple[str, str] | None = None) -> list[Claim]:
        """All claims for stages in order of time; with `swap`, for two channels with exchanged plugs."""
        if swap is not None:
            stages = [self._exchanged(stage, *swap) for stage in stages]
        if not stages:
            return []
        found: list[Claim] = []
        rest, place = stages[0], stages[0].means.get(DISPLACEMENT, 0.0)
        for number, stage in enumerate(stages):
            if stage.tripped in stage.means:
                found.append(replace(self._tripped(stage), stage=number))
            if stage.opened:
                found += [replace(claim, stage=number - 1) for claim in self._opened(stage, stages[number - 1], rest)]
            elif stage.pressure > 0:
                found += [replace(claim, stage=number) for claim in self._under_pressure(stage, rest, place)]
            elif stage.settled and (number == 0 or stages[number - 1].pressure == 0):  # else it has just been vented
                rest, place = stage, min(place, stage.means.get(DISPLACEMENT, 0.0), key=abs)
                found += [replace(claim, stage=number) for claim in self._rest(stage)]
        found += self._drive([stage for stage in stages if stage.place is not None and stage.pressure == 0])
        return found

    def _exchanged(self, stage: Stage, one: str, other: str) -> Stage:
        scales = {name: self.channels[name].scale for name in (one, other)}
        means, halves = dict(stage.means), dict(stage.halves)
        for here, there in ((one, other), (other, one)):
            if there in stage.means:
                means[here] = float(scales[here].to_si(scales[there].to_raw(stage.means[there])))
            if there in stage.halves:
                halves[here] = stage.halves[there]
        drift = 0.0 if PRESSURE in (one, other) else stage.drift
        tripped = "" if stage.settled and stage.tripped in (one, other) else stage.tripped  # by the other's plug then
        return replace(stage, means=means, halves=halves, drift=drift, tripped=tripped)

    def _rest(self, stage: Stage) -> Iterator[Claim]:
        """Vented: gauge pressure, set-point and an unloaded cell are zero, and the free end is where muscles rest."""
        means = stage.means
        if PRESSURE in means:
            yield self._near("pressure at rest", PRESSURE, means[PRESSURE], self.zero_limit(PRESSURE), "vented")
        if FORCE in means and (stage.load == 0 or (self.driven and stage.place is None)):
            yield self._near("force at rest", FORCE, means[FORCE], self.zero_limit(FORCE), "unloaded")
        if DISPLACEMENT in means and not self.driven:
            low, high = RESTS
            yield Claim(
                "displacement at rest",
                (DISPLACEMENT,),
                low <= means[DISPLACEMENT] <= high,
                show(means[DISPLACEMENT], "length", 4),
                f"{show(low, 'length')} to {show(high, 'length')}, no pressure",
                WRONG,
            )
        if SET in means and OUT.removeprefix("set ") in self.outputs:
            claim = self._near("read-back of the set-point at rest", SET, means[SET], self.follows_within(), "vented")
            yield replace(claim, wires=(SET, OUT))
        if DISPLACEMENT in means and PLACE in means:
            apart = means[DISPLACEMENT] - means[PLACE]
            claim = self._near("displacement and drive at rest", DISPLACEMENT, apart, RESTS[1], "apart")
            yield replace(claim, wires=(DISPLACEMENT, PLACE))

    def _tripped(self, stage: Stage) -> Claim:
        """A broken claim: no limit is crossed at the small pressures of a self-test, nor before them."""
        name = stage.tripped
        value = show(stage.means[name], self.channels[name].quantity, 4)
        wires = (name, OUT) if name == PRESSURE else (name,)
        return Claim(f"limit of {name}", wires, False, value, "not crossed", SCALE if stage.pressure else WRONG)

    def _near(self, row: str, name: str, value: float, limit: float, state: str) -> Claim:
        quantity = self.channels[name].quantity
        within = f"within {show(limit, quantity, 4)} of 0, {state}"
        return Claim(row, (name,), abs(value) <= limit, show(value, quantity, 4), within, WRONG)

    def _under_pressure(self, stage: Stage, rest: Stage, place: float) -> Iterator[Claim]:
        rises = {name: value - rest.means[name] for name, value in stage.means.items() if name in rest.means}
        yield from self._followed(stage, rises)
        if not stage.settled:
            return
        yield from self._signs(stage, rises)
        if stage.load is not None and FORCE in rises:
            yield from self._weighed(stage, rises)
        if stage.pressure >= self.top * (1 - 1e-9) and (stage.load is not None or self.driven):
            yield from self._as_expected(stage, rises, place)

    def _followed(self, stage: Stage, rises: Mapping[str, float]) -> Iterator[Claim]:
        """Commanded, read-back and measured pressure agree in pairs."""
        asked, most = stage.pressure, self.follows_within()
        row = FOLLOWS
        limit = f"rises by {show(asked, 'pressure', 4)} within {show(most, 'pressure', 3)}"
        if PRESSURE not in rises:
            return
        rise, back = rises[PRESSURE], rises.get(SET)
        noise = SIGNIFICANT * self.noise.get(PRESSURE, 0.0)
        if rise < -max(most, noise):
            yield Claim(row, (PRESSURE,), False, f"falls by {show(-rise, 'pressure', 4)}", limit, FLIPPED)
            return
        value = f"rises by {show(rise, 'pressure', 4)}"
        kind = STILL if abs(rise) < max(0.3 * asked, noise) else SCALE
        held = (self.dump.name,) if self.dump is not None and kind == STILL else ()
        also = (AIR, *held) if rise < asked else ()
        if stage.settled or rise > asked + most:
            yield Claim(row, (PRESSURE, OUT, *also), abs(rise - asked) <= most, value, limit, kind, exact=True)
        if stage.settled and abs(rise - asked) > most and abs(stage.drift) > max(0.05 * asked, 2 * noise / SIGNIFICANT):
            value = f"still changes, by {show(stage.drift, 'pressure', 3)} in a fifth of the hold"
            yield Claim("pressure comes to rest", (AIR,), False, value, "at rest at the end of the hold", STILL)
        if back is None:
            return
        seen = f"reads back {show(back, 'pressure', 4)} for {show(asked, 'pressure', 4)}"
        off = abs(back - asked)
        back_kind = FLIPPED if back < -most else STILL if back < 0.1 * asked else SCALE
        within = f"within {show(most, 'pressure', 3)}"
        yield Claim("read-back of the set-point", (SET, OUT), off <= most, seen, within, back_kind, exact=True)
        if not stage.settled:
            return
        also = (AIR, *held) if rise < back else ()
        seen = f"{show(rise, 'pressure', 4)} measured, {show(back, 'pressure', 4)} read back"
        agree = abs(rise - back) <= 2 * most
        yield Claim("pressure against read-back", (PRESSURE, SET, *also), agree, seen, within, kind)
        alike = self.channels[SET].device == self.channels[PRESSURE].device
        if alike and PRESSURE in stage.halves and SET in stage.halves and off <= most and abs(rise - asked) <= most:
            lead = stage.halves[SET] - stage.halves[PRESSURE]
            value = f"half way {1e3 * -lead:+.0f} ms after the read-back"
            yield Claim(LEAD, (PRESSURE, SET), lead <= LEADS, value, "after it", WRONG)

    def _opened(self, stage: Stage, before: Stage, rest: Stage) -> Iterator[Claim]:
        """An open dump valve lowers the pressure; if none was measured before, it must not rise."""
        if PRESSURE not in before.means:
            return
        came = abs(before.means[PRESSURE] - rest.means[PRESSURE]) > 0.3 * stage.pressure
        change = stage.means[PRESSURE] - before.means[PRESSURE]
        least = max(0.1 * stage.pressure, SIGNIFICANT * self.noise.get(PRESSURE, 0.0))
        value = f"the pressure {'rises' if change > 0 else 'falls'} by {show(abs(change), 'pressure', 3)}"
        row, limit = f"{stage.opened}, opened", f"falls by more than {show(least, 'pressure', 3)}"
        if came:
            yield Claim(row, (stage.opened, PRESSURE), change < -least, value, limit, STILL)
        elif change > least:
            yield Claim(row, (stage.opened,), False, value, limit, FLIPPED)

    def _signs(self, stage: Stage, rises: Mapping[str, float]) -> Iterator[Claim]:
        """Force and contraction do not fall under pressure; at the highest pressure one of them rises."""
        at = show(stage.pressure, "pressure", 4)
        moved = {}
        for name, what in ((FORCE, "force"), (DISPLACEMENT, "contraction")):
            if name in rises and not (name == DISPLACEMENT and self.driven):
                moved[name] = change = self.change(name, rises[name])
                quantity = self.channels[name].quantity
                value = f"{'rises' if change >= 0 else 'falls'} by {show(abs(change), quantity, 3)}" if change else ""
                value = f"{value or 'stays'} at {at}"
                yield Claim(f"{what} under pressure", (name,), change >= 0, value, "does not fall", FLIPPED)
        known = stage.load is not None or self.driven
        if known and moved and not any(moved.values()) and stage.pressure >= self.top * (1 - 1e-9):
            value = f"neither {' nor '.join(moved)} changes" if len(moved) > 1 else f"{next(iter(moved))} stays"
            yield Claim("answer of the muscle", (HOSE, *moved), False, value, "one of them rises", STILL)
        length = self.mounted.bench.length
        if moved.get(DISPLACEMENT, 0.0) > CONTRACTS * length > 0:
            value, most = show(moved[DISPLACEMENT], "length", 3), show(CONTRACTS * length, "length", 3)
            yield Claim("longest contraction", (DISPLACEMENT,), False, f"rises by {value}", f"at most {most}")

    def change(self, name: str, rise: float) -> float:
        """A change [SI], set to 0 below noise and uncertainty."""
        unknown = self.channels[name].calibration.offset_uncertainty if name == FORCE else MOVED
        return rise if abs(rise) > max(unknown, SIGNIFICANT * self.noise.get(name, 0.0)) else 0.0

    def _weighed(self, stage: Stage, rises: Mapping[str, float]) -> Iterator[Claim]:
        """A hanging load pulls with its weight; one on its support with at most that."""
        load, known, rise = stage.load or 0.0, self.channels[FORCE].calibration, rises[FORCE]
        limit = self.mounted.bench.load_tolerance * load + known.offset_uncertainty + known.gain_uncertainty * load
        value = f"{show(rise, 'force', 4)} for {show(load, 'force', 4)}"
        if load and rises.get(DISPLACEMENT, 0.0) > LIFTED:
            within = f"within {show(limit, 'force', 3)}"
            yield Claim("load cell", (PLATES, FORCE), abs(rise - load) <= limit, value, within, SCALE, exact=True)
        else:
            most = load + limit + FRICTION
            held = PLATES if load else HOSE
            at_most = f"at most {show(most, 'force', 3)}"
            yield Claim("force of a load on its support", (held, FORCE), rise <= most, value, at_most)

    def _as_expected(self, stage: Stage, rises: Mapping[str, float], rest: float) -> Iterator[Claim]:
        """Agreement with the specimen file within a rough factor: contraction under a load, blocked force.

        `rest` [m] is the reading nearest to zero without pressure: a support or a zero, which the muscle may leave.
        """
        expected = self.mounted.specimen_file.expected
        if expected is None or not _covers(expected, stage.pressure):
            return
        muscle = believed(expected, stage.pressure)
        pull, stiffness, friction, load = muscle.F_ce, muscle.K, muscle.F_c, stage.load or 0.0
        x, way = stage.means.get(DISPLACEMENT, 0.0), (pull - load - friction) / stiffness
        plates = (PLATES,) if load else ()
        if stage.load is not None and DISPLACEMENT in rises and way > 2 * MOVED * ROUGH:
            low, high = way / ROUGH + min(rest, 0.0), way * ROUGH + max(rest, 0.0)
            limit = f"{show(low, 'length', 3)} to {show(high, 'length', 3)}, by the specimen file"
            value = show(x, "length", 3)
            yield Claim("contraction as expected", (*plates, DISPLACEMENT, EXPECTED), low <= x <= high, value, limit)
        blocked = min(pull, load) if stage.load is not None else pull - stiffness * x
        still = stage.load is None or (pull - load) / stiffness < LIFTED
        if FORCE in rises and still and blocked > max(5 * friction, 20.0):
            near = blocked / ROUGH - friction <= rises[FORCE] <= blocked * ROUGH + friction
            limit = f"{show(blocked / ROUGH - friction, 'force', 3)} to {show(blocked * ROUGH + friction, 'force', 3)}"
            value = show(rises[FORCE], "force", 3)
            yield Claim("force as expected", (*plates, FORCE, EXPECTED), near, value, f"{limit}, by the specimen file")

    def _drive(self, stages: Sequence[Stage]) -> Iterator[Claim]:
        """Commanded, reported and measured position of the drive agree in pairs."""
        if not stages:
            return
        first, last = min(stages, key=lambda s: s.place or 0.0), max(stages, key=lambda s: s.place or 0.0)
        way = (last.place or 0.0) - (first.place or 0.0)
        most = DRIVE[0] * way + DRIVE[1]
        seen = [name for name in (DISPLACEMENT, PLACE) if name in first.means and name in last.means]
        gone = {name: last.means[name] - first.means[name] for name in seen}
        limit = f"within {show(most, 'length', 3)}"
        pairs = [(name, MOVE, gone[name], way) for name in seen]
        if len(seen) == 2:
            pairs.append((DISPLACEMENT, PLACE, gone[DISPLACEMENT], gone[PLACE]))
        for name, other, value, reference in pairs if way > 0 else ():
            against = "read-back of the drive" if other == PLACE else show(way, "length", 3)
            gone_for = f"{show(value, 'length', 3)} for {show(reference, 'length', 3)}"
            kind = FLIPPED if value < -most else STILL if abs(value) < most else SCALE
            off = abs(value - reference) <= most
            row = f"{name} driven, against {against}"
            yield Claim(row, (name, other), off, gone_for, limit, kind, exact=True)
        for name in seen:
            apart = first.means[name] - (first.place or 0.0)
            allowed = RESTS[1] if name == DISPLACEMENT else 2 * most
            row, within = f"{name} off where the drive was sent", f"within {show(allowed, 'length', 3)}"
            yield Claim(row, (name, MOVE), abs(apart) <= allowed, show(apart, "length", 3), within, WRONG)


def _covers(expected: ExpectedFile, pressure: float) -> bool:
    """Whether a pressure [Pa] is within the range of the expected points."""
    points = [point.pressure for point in expected.points]
    return min(points) * (1 - 1e-9) <= pressure <= max(points) * (1 + 1e-9)
