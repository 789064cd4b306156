"""Thousands of damaged answers: every call ends in time, in a DeviceError or a number, and no write is repeated."""

from __future__ import annotations

import time
from collections import Counter
from random import Random
from typing import Any

from pmabench.base.errors import DeviceError
from pmabench.conformance.commands import raw, sent, times_sent
from pmabench.conformance.damage import Hostile
from pmabench.conformance.rig import CALLS_WITHIN, COLLECTS_WITHIN, OPENS_WITHIN, Rig
from pmabench.conformance.samples import RATE, number, take
from pmabench.conformance.verdict import Failed, Late

LISTENS = 0.03
"""How long samples are damaged before they are collected [s]."""
HEALS = 2
"""How often a question may fail on a good wire before the device is opened again."""
OPENS = 5
"""How often it may fail to open after that."""


SELDOM_LATE = 500
"""Of so many pieces one call may be late: this computer has other things to do, too."""


class Battle:
    """Damages one piece after another; `many` pieces in all."""

    def __init__(self, rig: Rig, many: int, seed: int) -> None:
        self._rig, self._many, self._seed = rig, many, seed
        self._chance = Random(seed)
        self._damage = Hostile(self._chance)
        self._count: Counter[str] = Counter()
        self._device: Any = None
        self._times: list[int] = []

    def fight(self) -> str:
        """Run it; raises Failed with the number of the piece, so that the same seed finds it again."""
        rig = self._rig
        self._open()
        try:
            calls = 0
            while self._damage.done < self._many:
                kind = self._damage.another()
                calls += 1
                if calls > 50 and not self._damage.done:
                    raise Failed("the device has sent nothing that could be damaged in 50 calls")
                try:
                    if self._chance.random() < 0.03:
                        self._opening()
                    else:
                        self._one()
                except Late as failure:
                    self._count["late"] += 1
                    if self._count["late"] > 2 + self._damage.done // SELDOM_LATE:
                        raise Failed(f"{self._count['late']} calls were late; the last: {failure}") from None
                    self._open()
                except Failed as failure:
                    raise Failed(f"piece {self._damage.done} ({kind}, --seed {self._seed}): {failure}") from None
        finally:
            rig.well()
        answer = ", ".join(f"{count} {what}" for what, count in self._count.most_common())
        return f"{self._damage.done} damaged pieces: {answer}"

    def _open(self) -> None:
        """A new driver on a good wire; what came before may still be on its way."""
        rig = self._rig
        for attempt in range(OPENS):
            try:
                rig.shut()
                rig.open()
                if rig.streams():
                    rig.call("start()", rig.device.start, RATE).good(COLLECTS_WITHIN)
                break
            except Failed:
                if attempt == OPENS - 1:
                    raise
                time.sleep(0.2)
        self._device, self._times = rig.device, []

    def _opening(self) -> None:
        """The damage meets a device that is being opened."""
        rig = self._rig
        rig.shut()
        device = rig.build(rig.record)
        rig.damage(self._damage)
        self._note(rig.call("open()", device.open).judged(OPENS_WITHIN))
        rig.call("close()", device.close).judged(OPENS_WITHIN)
        rig.well()
        self._open()

    def _one(self) -> None:
        """One call on a damaged wire, then one on a good one."""
        rig = self._rig
        choices: list[tuple[str, Any]] = [("output", o) for o in rig.record.outputs for _ in range(2)]
        choices += [("valve", v) for v in rig.record.valves] + [("lock", i) for i in rig.record.interlocks]
        choices += [("samples", None)] if rig.streams() else []
        kind, record = self._chance.choice(choices)
        ask = getattr(self, f"_{kind}")
        rig.feed()
        rig.damage(self._damage)
        ask(record)
        rig.well()
        for _ in range(HEALS):
            if not isinstance(ask(record), DeviceError):
                return
        self._count["opened again"] += 1
        self._open()

    def _output(self, output: Any) -> Any:
        rig = self._rig
        if self._chance.random() < 0.5:
            answer = rig.call("read_back()", self._device.read_back, output.output).judged(CALLS_WITHIN)
            if not isinstance(answer, DeviceError | float | int):
                raise Failed(f"read_back() gave {answer!r}; a number is expected")
            return self._note(answer)
        value = raw(output, self._chance.uniform(output.low, output.high))
        before = len(sent(rig))
        answer = rig.call(f"write({value:g})", self._device.write, output.output, value).judged(CALLS_WITHIN)
        times = times_sent(rig, output, value, before)
        if times > 1:
            raise Failed(f"write({value:g}) was carried out {times} times; a write is never repeated")
        return self._note(answer)

    def _valve(self, valve: Any) -> Any:
        if self._chance.random() < 0.5:
            answer = self._rig.call("is_on()", self._device.is_on, valve.output).judged(CALLS_WITHIN)
            if not isinstance(answer, DeviceError | bool):
                raise Failed(f"is_on() gave {answer!r}; True or False is expected")
            return self._note(answer)
        on = self._chance.random() < 0.5
        return self._note(
            self._rig.call(f"switch(on={on})", self._device.switch, valve.output, on=on).judged(CALLS_WITHIN)
        )

    def _lock(self, lock: Any) -> Any:
        answer = self._rig.call("level()", self._device.level, lock.input).judged(CALLS_WITHIN)
        if not isinstance(answer, DeviceError | bool):
            raise Failed(f"level() gave {answer!r}; True or False is expected")
        return self._note(answer)

    def _samples(self, _nothing: Any) -> Any:
        rig = self._rig
        rig.pass_time(LISTENS)
        answer = rig.call("collect()", self._device.collect).judged(COLLECTS_WITHIN)
        if not isinstance(answer, DeviceError):
            values: dict[str, list[float]] = {channel.name: [] for channel in rig.record.channels}
            take(rig.record.channels, answer, self._times, values)
            del self._times[:-1]
            for channel in rig.record.channels:
                inside = [
                    channel.low <= channel.scale.to_si(number(channel, v)) <= channel.high for v in values[channel.name]
                ]
                self._count["samples in range"] += sum(inside)
                self._count["samples that are marked as out of range"] += len(inside) - sum(inside)
        return self._note(answer)

    def _note(self, answer: Any) -> Any:
        self._count["refused with a sentence" if isinstance(answer, DeviceError) else "answered"] += 1
        return answer
