"""Checks whether devices are still as the guard left them: restarts, lost watchdogs, commands from elsewhere (S11).

Decides nothing: `look` raises with the first difference. Each device is asked from the thread that owns it, one
question at a time, so that a command waits for at most one of them.
"""
# mypy: disable-error-code="type-abstract"

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from functools import partial
from math import inf
from typing import Any

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError, LimitRefused, LimitTripped
from pmabench.base.quantities import show
from pmabench.bench.interface import (
    CompiledBench,
    DeviceRecord,
    Inputs,
    OutputRecord,
    Supervised,
    ValveRecord,
    Watchdog,
)
from pmabench.guard.course import Course
from pmabench.guard.links import Act, Links
from pmabench.guard.owner import Call

EVERY = 0.45
"""Interval in which all questions to a device are asked once [s]."""
WITHIN = 1.0
"""A device that has answered no question for this time [s] is lost."""
LOOK, HUNG = 0.05, 0.5
"""Interval for feeding watchdogs and reading interlocks; and time after which an answer is no longer expected [s]."""
AGAIN = 0.03
"""A difference counts only if it persists for this time [s]: some devices report a new value late."""
LAG = 0.3
"""A device may be late by this time [s] on a ramp or a sine, or its set-points early."""
Kind = tuple[str, float, float, float]
HELD = ("whether it holds what was commanded", EVERY, WITHIN, 2.0)
FED = ("to a sign of life", LOOK, 0.0, 2.0)
SAFE = ("whether its interlocks are closed", LOOK, 0.0, 4.0)
"""Kind of question: wording, interval [s], time limit [s], and pause before the next one, in multiples of its duration.

The pause leaves time for samples on the line of a slow device.
"""
KINDS: tuple[Kind, ...] = (FED, SAFE, HELD)
READS = ("range", "unit", "format", "mapping", "step", "forced", "modules")
"""Words in reported keys that affect the meaning of samples; other keys may change by a restart or a watchdog."""
UNANSWERED = "has not answered whether it is as it was when the bench was armed"
ELSEWHERE = "it restarted, or something else commands it"


class Supervision:
    """Supervision of the devices of one bench. `course` and `closed` hold the last commands to outputs and valves."""

    def __init__(
        self,
        bench: CompiledBench,
        links: Links,
        clock: Clock,
        course: Callable[[OutputRecord], Course],
        closed: Mapping[str, bool],
    ) -> None:
        self._bench, self._links, self._clock = bench, links, clock
        self._course, self._closed = course, closed
        self._held: dict[str, dict[str, float | str]] = {}
        """What each device reported when the bench was armed."""
        self._uptime: dict[str, float] = {}
        """Uptime of each device that reports one, as last read."""
        self._compared: dict[str, Call] = {}
        """Comparisons of each device with its report at arming, made outside the round of questions."""
        self._asked: dict[str, Call] = {}
        self._count: dict[str, int] = {}
        self._since: dict[str, float] = {}
        """When each question was last asked, and (`_answered`) last answered [s]."""
        self._answered: dict[str, float] = {}
        self._lost: dict[str, bool] = {}
        """Whether the previous answer was lost too: one lost answer is no lost device."""

    def begin(self) -> None:
        """Keep what each device reports now; called when the bench has just been armed."""
        for name, device in list(self._links.devices.items()):
            if isinstance(device, Supervised):
                self._held[name] = dict(self._links.call(name, device.held))

    def look(self, now: float) -> None:
        """Ask what is due at `now` [s]; raises LimitTripped (interlock), LimitRefused (change) or DeviceError."""
        for record in self._bench.devices:
            if record.name in self._links.devices:
                for kind in self._by_age(record, KINDS):
                    self._ask(record, kind, now)

    def attend(self, record: DeviceRecord, now: float, kinds: list[Kind]) -> None:
        """Ask a device during a vent; raises LimitTripped if an interlock is open, ignores missing answers."""
        if record.name in self._links.devices:
            for kind in self._by_age(record, kinds):
                with suppress(DeviceError):
                    self.feed(record, now, kind)

    def feed(self, record: DeviceRecord, now: float, kind: Kind = FED) -> None:
        """Ask one kind of question if it is due (feed the watchdog); raises DeviceError if that fails."""
        try:
            self._ask(record, kind, now)
        except DeviceError:
            self._asked.pop(record.name + kind[0])  # it may recover: it is asked again
            raise

    def _by_age(self, record: DeviceRecord, kinds: Sequence[Kind]) -> list[Kind]:
        """Kinds in the order of their last question, oldest first: a device may seldom be free."""
        return sorted(kinds, key=lambda kind: self._since.get(record.name + kind[0], -inf))

    def _ask(self, record: DeviceRecord, kind: Kind, now: float) -> None:
        """Ask a device that is free the next question of a kind."""
        name, (what, every, within, rests) = record.name, kind
        questions = self._questions(record, kind)
        if not questions:
            return
        key, call = name + what, self._asked.get(name + what)
        if call is None or (call.done.is_set() and call.error is None):
            if call is not None and call.result:
                raise (LimitTripped if kind is SAFE else LimitRefused)(f"{name}: {call.result}")
            self._answered[key] = now
        failed = call is not None and call.error is not None
        silent = now - self._answered[key]
        if silent > (within if failed else max(within, HUNG)) and (not failed or self._lost[key]):
            why = f"has not answered for {within or round(silent, 1):g} s {what}"
            raise DeviceError(name, f"{why} ({call.error})" if call is not None and call.error else why)
        pause = rests * (0.0 if call is None or failed else call.ended - call.asked)
        if now - self._since.get(key, -inf) >= max(every / len(questions), pause) and self._links.free(name):
            self._since[key], self._count[key], self._lost[key] = now, self._count.get(key, -1) + 1, failed
            self._asked[key] = self._links.submit(name, questions[self._count[key] % len(questions)])

    def compare(self) -> None:
        """Ask every device whether it is still as it was when the bench was armed; does not wait."""
        for name in self._held:
            known = self._links.devices.get(name)  # its line may be closed before the question is asked
            self._compared[name] = self._links.submit(name, partial(self._held_differs, name, known))

    def compare_readings(self, names: Collection[str]) -> list[Call]:
        """Calls that ask these devices whether the meaning of their samples is as it was at arming; not waited for."""
        calls = []
        for name in self._held.keys() & names:
            if keys := [key for key in self._held[name] if any(word in key for word in READS)]:
                calls.append(self._links.submit(name, partial(self._readings_differ, name, keys)))
        return calls

    def _readings_differ(self, name: str, keys: list[str]) -> str:
        text = self._held_differs(name, keys=keys)
        return f"{name}: {text}" if text else ""

    def differences(self) -> list[str]:
        """Results of `compare` so far: a sentence per device that changed or did not answer; repeats failed calls."""
        found = []
        for name, call in list(self._compared.items()):
            if call.error is not None:
                self._compared[name] = self._links.submit(name, partial(self._held_differs, name))
            answered = call.done.is_set() and call.error is None
            found.append(f"{name}: {call.result if answered else UNANSWERED}")
        return [text for text in found if not text.endswith(": ")]

    def _questions(self, record: DeviceRecord, kind: Kind) -> Sequence[Act]:
        if kind is SAFE:
            return [partial(self.open_interlock, record)] if record.interlocks else []
        if kind is FED:
            device = self._links.devices.get(record.name)
            return [device.feed_watchdog] if record.watchdog and isinstance(device, Watchdog) else []
        held = [partial(self._twice, partial(self._held_differs, record.name))] if record.name in self._held else []
        valves = (self.valve_differs(valve, closed=self._closed[valve.name]) for valve in record.valves
                  if not valve.longest)  # fmt: skip
        return [*held, *(self.output_differs(output) for output in record.outputs), *valves]

    # -- questions: the answer is an empty text, or a sentence on what differs ----------------------------------------

    def _twice(self, look: Callable[[], str]) -> str:
        if not look():
            return ""
        self._clock.wait_until(self._clock.now() + AGAIN)
        return look()

    def _held_differs(self, name: str, known: Any = None, keys: Collection[str] = ()) -> str:
        device = known or self._links.need(name, Supervised, "reports nothing of itself")
        now, before = device.held(), self._held[name]
        for key, was in before.items():
            if keys and key not in keys:
                continue
            value = now.get(key, "not reported")
            if key == "uptime" and not isinstance(value, str) and not isinstance(was, str):
                if value < was:
                    return f"it restarted: its uptime fell from {was:g} to {value:g}"
                # a single reading may be torn: the two words of a counter are read while the lower one overflows
                before[key] = max(was, min(value, self._uptime.get(name, was)))
                self._uptime[name] = value
            elif value != was:
                why = "" if "fault" in key else f": {ELSEWHERE}"
                return f"its {key} was {_shown(was)} when the bench was armed and is {_shown(value)} now{why}"
        return ""

    def output_differs(self, output: OutputRecord) -> Act:
        """Question whether an output holds its commanded value at the time it is asked."""
        course = self._course(output)

        def look() -> str:
            since = self._clock.now()
            held = self._links.read_back(output)
            moments = [since - LAG, since, since + LAG, *(t for t in course.crests(since) if abs(t - since) < LAG), inf]
            ends = [float(output.scale.to_raw(course(moment))) for moment in moments]  # inf: some drives hold the end
            slack = output.resolution + 1e-6 * max(map(abs, (*ends, output.scale.to_raw(output.high))))
            if min(ends) - slack <= held <= max(ends) + slack:
                return ""
            sent, value = (show(si, output.quantity) for si in (course(self._clock.now()), output.scale.to_si(held)))
            return f'"{output.name}" was commanded to {sent} and the device holds {value} as set-point: {ELSEWHERE}'

        return partial(self._twice, look)

    def open_interlock(self, record: DeviceRecord) -> str:
        """Sentence on the first open interlock of a device; empty if all are closed."""
        for interlock in record.interlocks:
            inputs = self._links.need(record.name, Inputs, "has no digital inputs", interlock.input)
            if inputs.level(interlock.input) != (interlock.safe == "high"):
                return f'the interlock "{interlock.name}" is open ({record.name}.{interlock.input})'
        return ""

    def valve_differs(self, valve: ValveRecord, *, closed: bool) -> Act:
        """Question whether a valve is as commanded."""

        def look() -> str:
            if self._links.is_closed(valve) == closed:
                return ""
            words = ("closed", "open") if closed else ("open", "closed")
            return f'"{valve.name}" was commanded {words[0]} and the device holds it {words[1]}: {ELSEWHERE}'

        return partial(self._twice, look)


def _shown(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"
