"""Checks of a driver on a silent, slow or broken connection, and with thousands of damaged answers.

Every call ends in time, in a DeviceError or a number; no write is repeated; nothing is left behind.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from random import Random
from typing import Any

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import OutputRecord
from pmabench.conformance import rig as rigs
from pmabench.conformance.commands import near, raw, sent, times_sent
from pmabench.conformance.relay import Hostile, late, silence
from pmabench.conformance.samples import RATE, number, take

LATE = 0.35
"""Delay of answers, longer than every time-out of a call [s]."""
SETTLES = 3.0
"""Time for threads and connections to end [s]."""
MANY = 10
"""Rounds of questions after which no more threads or files may be open than before."""
RECOVERS = 5
"""How often a question may fail after the connection is good again."""
LISTENS = 0.03
"""Duration of damaged sampling before samples are collected [s]."""
HEALS = 2
"""How often a question may fail on a good connection before the device is opened again."""
OPENS = 5
"""How often opening it may fail then."""
SELDOM_LATE = 500
"""One late call is allowed per this number of damaged pieces, as the computer may be busy."""


def calls(rig: rigs.Rig, device: Any) -> list[tuple[str, Callable[[], Any], float]]:
    """Everything that guard and engine call during a run: name, call, longest time [s]."""
    found: list[tuple[str, Callable[[], Any], float]] = []
    for output in rig.record.outputs:
        value = _fifth(output)
        found.append((f"write({value:g})", partial(device.write, output.output, value), rigs.CALLS_WITHIN))
    for valve in rig.record.valves:
        found.append(("switch(on=False)", partial(device.switch, valve.output, on=False), rigs.CALLS_WITHIN))
    within = {"collect()": rigs.COLLECTS_WITHIN}
    return found + [(what, act, within.get(what, rigs.CALLS_WITHIN)) for what, act in rig.questions(device)]


def _fifth(output: OutputRecord) -> float:
    """A value one fifth of the range above the safe one [device units]."""
    return raw(output, output.safe + 0.2 * (output.high - output.safe))


def silent(rig: rigs.Rig) -> str:
    """When the device stops answering, every call raises DeviceError in time, and a write is sent once."""
    answers: list[str] = []
    for sampling in (False, True) if rig.streams() else (False,):
        with rig.opened(rate=RATE if sampling else 0.0) as device:
            rig.damage(silence)
            answers += _in_silence(rig, device)
            if sampling:
                answers.append(_says_that_samples_stay_away(rig, device))
            rig.shut()  # in silence, too, within its time
    return f"{len(answers)} calls say so in time; the last: {answers[-1]}" if answers else "nothing could be asked"


def _in_silence(rig: rigs.Rig, device: Any) -> list[str]:
    """Answer of each call as text; raises Failed if a write is carried out more than once."""
    answers = []
    for what, act, within in calls(rig, device):
        before = len(sent(rig))
        answer = rig.call(f"{what} in silence", act).judged(within)
        if not isinstance(answer, DeviceError) and not what.startswith("collect"):
            expected = "what was not answered is a DeviceError, never an answer from memory"
            raise rigs.Failed(f"{what} in silence gave {answer!r} as if all were well; {expected}")
        answers.append(str(answer))
        time.sleep(0.05)
        for output in rig.record.outputs if what.startswith("write") else ():
            if (times := times_sent(rig, output, _fifth(output), before)) > 1:
                raise rigs.Failed(f"{what} in silence was carried out {times} times; a write is never repeated")
    return answers


def _says_that_samples_stay_away(rig: rigs.Rig, device: Any) -> str:
    """Text for a silent stream: `collect` raises DeviceError, or gives no samples, which the engine notices."""
    for _ in range(15):
        rig.pass_time(0.1)
        block = rig.call("collect() in silence", device.collect).judged(rigs.COLLECTS_WITHIN)
        if isinstance(block, DeviceError):
            return str(block)
    if len(block.time):
        raise rigs.Failed("samples keep coming 1.5 s after the device has fallen silent: they are made up")
    return "collect() gives no samples"


def late_answers(rig: rigs.Rig) -> str:
    """A late answer is never taken for the answer to the next question."""
    output = rig.record.outputs[0]
    safe = raw(output, output.safe)
    refused = 0
    with rig.opened() as device:
        rig.call("write()", device.write, output.output, safe).good()
        holds = [safe]
        for share in (0.3, 0.1, 0.2):
            rig.feed()  # a device whose watchdog has fired accepts no value that could be mixed up
            value = raw(output, output.safe + share * (output.high - output.safe))
            rig.damage(late(LATE))
            for _ in range(2):  # so that one answer is still outstanding after the next command
                rig.call("read_back() with a late answer", device.read_back, output.output).judged()
            rig.well()
            before = len(sent(rig))
            done = rig.call("write() after a late answer", device.write, output.output, value).judged()
            known = not isinstance(done, DeviceError) or times_sent(rig, output, value, before)
            holds = [value] if known else [*holds, value]
            for _ in range(RECOVERS):
                held = rig.call("read_back() after a late answer", device.read_back, output.output).judged()
                if not isinstance(held, DeviceError):
                    break
                refused += 1
                time.sleep(0.1)
            else:
                rig.shut()
                rig.open()
                device = rig.device
                rig.call("write()", device.write, output.output, safe).good()
                holds = [safe]
                continue
            holds += [safe] if rig.logged("watchdog") else []  # the driver was silent for that long
            if not any(near(output, held, one) for one in holds):
                why = "the answer to an older question was taken; drain the line after a time-out"
                raise rigs.Failed(f"read_back() gave {held!r} where the device holds {holds[-1]:g}: {why}")
    return f"three late answers, no value mixed up ({refused} questions refused meanwhile)"


def hang_up(rig: rigs.Rig) -> str:
    """When the line is cut, calls say so in time, and after a new open() all is well."""
    with rig.opened(rate=RATE) as device:
        for relay in rig.relays:
            relay.hang_up()
        answers: list[str] = []
        until = time.monotonic() + 2.0
        while time.monotonic() < until and not answers:
            for what, act, within in calls(rig, device):
                answer = rig.call(f"{what} on a cut line", act).judged(within)
                if isinstance(answer, DeviceError):
                    answers.append(str(answer))
            time.sleep(0.1)
        if not answers and all(relay.address.startswith("/") for relay in rig.relays):
            raise rigs.Failed("2 s after the plug was pulled no call has said so")
        rig.shut()
        rig.renew_wire()
        rig.open()
    return f"says: {answers[0]}" if answers else "connects again by itself"


def nothing_left(rig: rigs.Rig) -> str:
    """After close() no thread, no file and no connection is left, whether all was well or the wire silent."""
    for wire in ("first", "good", "silent"):  # what the emulator itself keeps open is there after the first
        before = _left()
        rig.open()
        device: Any = rig.device
        if rig.streams():
            rig.call("start()", device.start, RATE).good(rigs.COLLECTS_WITHIN)
        if wire == "silent":
            rig.damage(silence)
        else:
            _refuse_growth(rig, device)
        rig.shut()
        rig.well()
        if wire == "first":
            continue
        until = time.monotonic() + SETTLES
        while (left := _left())[1] > before[1] or left[0] - before[0]:
            if time.monotonic() > until:
                threads = ", ".join(sorted(left[0] - before[0])) or "none"
                more = f"{left[1] - before[1]} more open files or connections than before, and threads: {threads}"
                raise rigs.Failed(f"{SETTLES:g} s after close() on a {wire} wire there are {more}")
            time.sleep(0.05)
    return "no thread, no file and no connection"


def _refuse_growth(rig: rigs.Rig, device: Any) -> None:
    """Raise Failed if calls leave threads or files behind while the device is open."""
    asked = rig.questions(device)
    for rounds in (3, MANY):
        before = _left()
        for _ in range(rounds):
            for what, act in asked:
                rig.call(what, act).judged(rigs.COLLECTS_WITHIN)
    after = _left()
    if max(after[1] - before[1], len(after[0] - before[0])) >= MANY:
        left = f"{after[1] - before[1]} open files or connections and {len(after[0] - before[0])} threads"
        raise rigs.Failed(f"{MANY} rounds of {', '.join(what for what, _ in asked)} leave {left}")


def _left() -> tuple[frozenset[str], int]:
    """Names of the living threads, and number of open files."""
    threads = [thread for thread in threading.enumerate() if not thread.name.startswith("link-")]
    return frozenset(f"{thread.name} ({thread.ident})" for thread in threads), rigs.open_files()


class Battle:
    """Random calls with damaged answers, until `many` pieces have been damaged."""

    def __init__(self, rig: rigs.Rig, many: int, seed: int) -> None:
        self._rig, self._many, self._seed = rig, many, seed
        self._chance = Random(seed)
        self._damage = Hostile(self._chance)
        self._count: Counter[str] = Counter()
        self._device: Any = None
        self._times: list[int] = []

    def fight(self) -> str:
        """Run it; raises Failed with the number of the piece and the seed, to reproduce it."""
        rig = self._rig
        self._open()
        try:
            calls = 0
            while self._damage.done < self._many:
                kind = self._damage.another()
                calls += 1
                if calls > 50 and not self._damage.done:
                    raise rigs.Failed("the device has sent nothing that could be damaged in 50 calls")
                try:
                    if self._chance.random() < 0.03:
                        self._opening()
                    else:
                        self._one()
                except rigs.Late as failure:
                    self._count["late"] += 1
                    if self._count["late"] > 2 + self._damage.done // SELDOM_LATE:
                        raise rigs.Failed(f"{self._count['late']} calls were late; the last: {failure}") from None
                    self._open()
                except rigs.Failed as failure:
                    raise rigs.Failed(f"piece {self._damage.done} ({kind}, --seed {self._seed}): {failure}") from None
        finally:
            rig.well()
        answer = ", ".join(f"{count} {what}" for what, count in self._count.most_common())
        return f"{self._damage.done} damaged pieces: {answer}"

    def _open(self) -> None:
        """Open a new driver on a good connection, with retries as old bytes may still arrive."""
        rig = self._rig
        for attempt in range(OPENS):
            try:
                rig.shut()
                rig.open()
                if rig.streams():
                    rig.call("start()", rig.device.start, RATE).good(rigs.COLLECTS_WITHIN)
                break
            except rigs.Failed:
                if attempt == OPENS - 1:
                    raise
                time.sleep(0.2)
        self._device, self._times = rig.device, []

    def _opening(self) -> None:
        """Open and close a device on a damaged connection."""
        rig = self._rig
        rig.shut()
        device = rig.build(rig.record)
        rig.damage(self._damage)
        self._note(rig.call("open()", device.open).judged(rigs.OPENS_WITHIN))
        rig.call("close()", device.close).judged(rigs.OPENS_WITHIN)
        rig.well()
        self._open()

    def _one(self) -> None:
        """One call on a damaged connection, then the same on a good one."""
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
            return self._asked("read_back()", self._device.read_back, output.output, float | int, "a number")
        value = raw(output, self._chance.uniform(output.low, output.high))
        before = len(sent(rig))
        answer = rig.call(f"write({value:g})", self._device.write, output.output, value).judged()
        if (times := times_sent(rig, output, value, before)) > 1:
            raise rigs.Failed(f"write({value:g}) was carried out {times} times; a write is never repeated")
        return self._note(answer)

    def _valve(self, valve: Any) -> Any:
        if self._chance.random() < 0.5:
            return self._asked("is_on()", self._device.is_on, valve.output, bool, "True or False")
        on = self._chance.random() < 0.5
        return self._note(self._rig.call(f"switch(on={on})", self._device.switch, valve.output, on=on).judged())

    def _lock(self, lock: Any) -> Any:
        return self._asked("level()", self._device.level, lock.input, bool, "True or False")

    def _asked(self, what: str, act: Callable[[str], Any], name: str, kind: Any, expected: str) -> Any:
        answer = self._rig.call(what, act, name).judged()
        if not isinstance(answer, DeviceError | kind):
            raise rigs.Failed(f"{what} gave {answer!r}; {expected} is expected")
        return self._note(answer)

    def _samples(self, _nothing: Any) -> Any:
        rig = self._rig
        rig.pass_time(LISTENS)
        answer = rig.call("collect()", self._device.collect).judged(rigs.COLLECTS_WITHIN)
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
