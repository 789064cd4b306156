"""The self-test of a bench with several muscles, one by one: zero, own regulator, leak, and direction of pull.

Exchanged hoses are dangerous on a joint: a controller would push it the wrong way. So the first pressure is small and
goes to one muscle after the other, and nothing higher follows before each output has moved its own channel only.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import inf

from pmabench.base.quantities import show
from pmabench.bench.compile import Mounted
from pmabench.bench.session import SelfTest
from pmabench.engine.executor import Executor
from pmabench.protocol.plan import Set
from pmabench.session.checks import NOT_CHECKED, NOT_MEASURED, Check, at_rest, judged, refuse
from pmabench.session.guided import above, listen
from pmabench.session.stepping import NO_LEAK, REST, isolation, leaks
from pmabench.session.wiring import SIGNIFICANT, Wiring

PHASE = "self-test"
LAST = 0.2
"""Last fraction of a hold over which the mean is taken."""
TOGETHER = 0.75
"""Pressure of all muscles while one of them gets the highest, as a fraction of the highest."""
SAME = "explained by the same"
WAYS = {"1": 1.0, "2": -1.0}
"""Muscle of a joint -> sign of the angle and torque in whose direction it pulls."""
Rises = Mapping[str, Mapping[str, float]]
"""Muscle whose output alone was commanded -> muscle -> rise of its channel [Pa]."""


def alone(rises: Rises, asked: float, within: float, wired: Wiring) -> Iterator[Check]:
    """A line for each muscle that got `asked` [Pa] alone: its own channel follows `within` [Pa], no other moves."""
    moved = {muscle: [other for other, rise in seen.items() if abs(rise) > within] for muscle, seen in rises.items()}
    explained: set[str] = set()
    for muscle, seen in rises.items():
        own, others = seen[muscle], [other for other in moved[muscle] if other != muscle]
        value = f"pressure_{muscle} rises by {show(own, 'pressure', 3)}" if muscle in moved[muscle] else ""
        also = [f"pressure_{other} rises by {show(seen[other], 'pressure', 3)}" for other in others]
        yield judged(
            f"muscle {muscle} alone",
            ", ".join([value or f"pressure_{muscle} stays", *also]),
            f"rises by {show(asked, 'pressure', 3)} within {show(within, 'pressure', 2)}, no other does",
            good=abs(own - asked) <= within and not others,
            hint=SAME if muscle in explained else _why(muscle, others, moved, wired, own),
        )
        explained |= {other for other in others if moved.get(other) == [muscle]}


def _why(muscle: str, others: Sequence[str], moved: Mapping[str, Sequence[str]], wired: Wiring, own: float) -> str:
    """Explanation if a muscle's channel does not follow its output, or if others do."""
    out, channel = f"output pressure_{muscle} ({wired.output(f'pressure_{muscle}')})", wired.input(f"pressure_{muscle}")
    if others and muscle not in moved[muscle]:
        other = others[0]
        if moved.get(other) == [muscle]:
            sensors = wired.input(f"pressure_{muscle}", f"pressure_{other}")
            return (
                f"muscles {muscle} and {other} are exchanged: {out} moves the pressure of muscle {other}. Exchange "
                f"back their hoses, or the plugs of their pressure sensors ({sensors}); "
                "until then nothing more is pressurised, for a controller would push the wrong way"
            )
        return f"{out} moves the pressure of muscle {other} instead: look at the hoses, then at the sensors' plugs"
    if others:
        return f"{out} also moves muscle {', '.join(others)}: their hoses are joined, or two sensors are on one muscle"
    if own < 0:
        return f"the sign of the pressure of muscle {muscle} ({channel}) is wrong: look at its wires and calibration"
    return (
        f"muscle {muscle} does not follow: look at its hose and regulator, at the wire of {out} and of its sensor "
        f"({channel}), and at their scales"
    )


def pulls(changes: Mapping[str, float], noise: float, channel: str, quantity: str) -> Iterator[Check]:
    """A line for each muscle of a joint: in which direction more pressure changed angle or torque (`channel`) [SI]."""
    wrong = [muscle for muscle, change in changes.items() if change * WAYS[muscle] < -SIGNIFICANT * noise]
    for muscle, change in changes.items():
        row, way = f"muscle {muscle} pulls", "up" if WAYS[muscle] > 0 else "down"
        if abs(change) <= SIGNIFICANT * noise:
            yield Check(row, "", "", NOT_CHECKED, f"the {channel} changes too little to see which way")
            continue
        value = f"{channel} goes {'up' if change > 0 else 'down'} by {show(abs(change), quantity, 3)}"
        yield judged(
            row, value, f"{channel} goes {way}", good=muscle not in wrong, hint=_backwards(muscle, wrong, channel)
        )


def _backwards(muscle: str, wrong: Sequence[str], channel: str) -> str:
    """Explanation for a muscle that pulls the wrong way; `wrong` are all such muscles."""
    if list(wrong) == [muscle]:
        return f"muscle {muscle} pulls the wrong way: look on which side of the joint it is mounted"
    if muscle not in wrong[:1]:
        return SAME
    return (
        "both muscles pull the wrong way: their hoses are exchanged, together with the plugs of their pressure "
        f"sensors, or the sign of the {channel} is wrong; find out which before anything is pressurised"
    )


class EachMuscle:
    """Applies small pressures to every muscle, alone and together; `checks` is the table so far."""

    def __init__(self, mounted: Mounted, test: SelfTest) -> None:
        self._mounted, self._test = mounted, test
        self._wires = Wiring(mounted)
        muscles = {f"pressure_{number}": number for number in mounted.bench_file.muscles}
        self._names = {muscles[output.name]: output.name for output in mounted.bench.outputs if output.name in muscles}
        self.checks: list[Check] = []
        self.leaks: dict[str, dict[str, float]] = {}
        """Muscle -> set `pressure` [Pa], rate `falls` [Pa/s] and the `half_width` of its 95 % interval."""
        self._rest: dict[str, float] = {}
        self._noise: dict[str, float] = {}

    def first(self, executor: Executor) -> None:
        """Channels at rest, then the first small pressure in each muscle alone."""
        series = listen(executor.acquisition, REST)
        self._rest = {name: one.mean() for name, one in series.items()}
        self._noise = {name: one.reading().noise for name, one in series.items()}
        self.checks += at_rest(self._mounted, series, self._test.noise)
        self.checks += list(self._zeros())
        refuse(self.checks)
        asked = self._test.points[0]
        rises = {}
        most = 2 * asked + self._within()
        for number, name in self._names.items():
            seen = self._go(executor, {name: asked}, most)
            rises[number] = {other: seen[channel] for other, channel in self._names.items() if channel in seen}
            if max(rises[number].values()) > most:
                break
            self._go(executor, {name: 0.0})
        self.checks += list(alone(rises, asked, min(self._within(), 0.4 * asked), self._wires))
        refuse(self.checks)

    def run(self, executor: Executor) -> None:
        """All muscles together in rising steps; then the direction of pull; then the leak of each."""
        if not self._rest:
            self.first(executor)
        off: dict[str, tuple[float, float]] = dict.fromkeys(self._names, (0.0, 0.0))
        for point in self._test.points:
            seen = self._go(executor, dict.fromkeys(self._names.values(), point))
            for number, name in self._names.items():
                off[number] = max(off[number], (seen[name] - point, point), key=lambda one: abs(one[0]))
            if max(abs(one) for one, _at in off.values()) > self._within():
                break
        self.checks += [self._steady(number, *worst) for number, worst in off.items()]
        refuse(self.checks)
        if self._mounted.bench.free_end == "joint":
            self.checks += list(self._pulls(executor))
            refuse(self.checks)
        self._go(executor, dict.fromkeys(self._names.values(), 0.0))
        self.checks += list(self._leak(executor))
        refuse(self.checks)

    def _go(self, executor: Executor, pressures: Mapping[str, float], most: float = inf) -> dict[str, float]:
        """Command pressures [Pa]; returns the rise of every channel from rest at the end of the hold [SI].

        The hold ends early if a pressure rises by more than `most` [Pa]; that rise is then returned.
        """
        limits = {name: self._rest[name] + most for name in self._names.values()}
        for name, pressure in pressures.items():
            executor.do(Set(PHASE, name, pressure))
        series = listen(executor.acquisition, self._test.settle, above(limits))
        ends = {name: one.mean(LAST * self._test.settle) for name, one in series.items() if name in self._rest}
        ends |= {name: top for name in limits if (top := float(series[name].y.max())) > limits[name]}
        return {name: value - self._rest[name] for name, value in ends.items()}

    def _within(self) -> float:
        """Allowed deviation of a pressure from its command [Pa]."""
        channels = [c for c in self._mounted.bench.channels if c.name in self._names.values()]
        unknown = max(c.calibration.offset_uncertainty for c in channels)
        return self._test.linearity * self._test.points[-1] + unknown

    def _zeros(self) -> Iterator[Check]:
        for number, name in self._names.items():
            most = self._wires.zero_limit(name)
            reads = self._rest[name]
            yield judged(
                f"muscle {number} at rest",
                show(reads, "pressure", 4),
                f"within {show(most, 'pressure', 4)} of 0, vented",
                good=abs(reads) <= most,
                hint=f"look at the wire of the pressure of muscle {number} ({self._wires.input(name)}), at its "
                "range and its calibration",
            )

    def _steady(self, number: str, off: float, at: float) -> Check:
        limit = self._within()
        return judged(
            f"regulator of muscle {number}, steady",
            f"{show(off, 'pressure', 3)} off at {show(at, 'pressure', 4)}" if at else "as commanded",
            f"at most {show(limit, 'pressure', 3)} off",
            good=abs(off) <= limit,
            hint=f"a leak of muscle {number}, too little supply, or the scale of its output "
            f"({self._wires.output(self._names[number])}) or of its sensor ({self._wires.input(self._names[number])})",
        )

    def _pulls(self, executor: Executor) -> Iterator[Check]:
        """Give one muscle after the other more pressure; check the angle, or the torque if a drive holds the joint."""
        driven = any(output.name == "angle" for output in self._mounted.bench.outputs)
        channel = "torque" if driven else "angle"
        if channel not in self._rest:
            yield Check("muscles pull", "", "", NOT_MEASURED, f"no {channel} is measured on this bench")
            return
        top, every = self._test.points[-1], self._names.values()
        changes = {}
        for number, name in self._names.items():
            before = self._go(executor, dict.fromkeys(every, TOGETHER * top))[channel]
            changes[number] = self._go(executor, {name: top})[channel] - before
        self._go(executor, dict.fromkeys(every, TOGETHER * top))
        yield from pulls(changes, self._noise[channel], channel, channel)

    def _leak(self, executor: Executor) -> Iterator[Check]:
        """Rate of fall of each pressure with the isolation valve shut, if the safe state shuts that valve."""
        if not isolation(self._mounted):
            yield NO_LEAK
            return
        self._go(executor, dict.fromkeys(self._names.values(), self._test.points[-1]))
        rows = {
            name: (
                f"leak of muscle {number}",
                f"look at muscle {number} and at hoses and fittings between the isolation valve and its end",
            )
            for number, name in self._names.items()
        }
        for number, (check, numbers) in zip(self._names, leaks(executor, self._mounted, self._test, rows), strict=True):
            self.leaks[number] = numbers
            yield check
