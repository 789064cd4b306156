"""The port of a board: one thread reads every line and gives answers to whoever asked by their number; knows no bench.

A question is sent once. It has a number that no other has for a long time, so a late answer never belongs to another.
"""

from __future__ import annotations

import contextlib
import random
import threading
from collections.abc import Callable
from time import monotonic

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench_drivers.serial_line_daq.wire import END, REASONS, NoLine, decode, encode
from pmabench_drivers.shared.lines import Splitter, readable
from pmabench_drivers.shared.link import Still, Unanswered, always, turn
from pmabench_drivers.shared.serial_port import SerialPort


class Link:
    """An open port; `on_sample` gets the fields of each `S` line and when it came [s, bench time], on its thread."""

    def __init__(
        self, device: str, address: str, baud: int, clock: Clock, on_sample: Callable[[list[str], float], None]
    ) -> None:
        self._device, self._on_sample = device, on_sample
        self._port = SerialPort(device, address, baud, clock)
        self._turn, self._sending = threading.Lock(), threading.Lock()
        self._waiting: dict[int, tuple[threading.Event, list[list[str]]]] = {}
        self._number = random.randrange(1 << 20)
        self._splitter = Splitter(END, whole=True)  # what is not whole has a wrong checksum
        self.invalid = 0
        """Lines that could not be read."""
        self.last = ""
        """The last one of them."""
        self._port.listen(self._read)

    @property
    def gone(self) -> str:
        """Why the port is lost."""
        return self._port.gone

    def close(self) -> None:
        """Let go of the port; harmless when repeated."""
        self._port.close()

    def ask(self, deadline: float, letter: str, *values: int, still: Still = always, aside: bool = False) -> list[str]:
        """What the board answers before `deadline` [s, monotonic]; nothing is sent if `still()` is false by then.

        One question is under way at a time: a board has little room for what comes in. One that goes `aside` does not
        wait for its turn. Raises DeviceError where the board refuses, Unanswered where nothing comes.
        """
        busy = f"has not answered yet what was asked before; the question {letter} was not sent"
        with contextlib.nullcontext() if aside else turn(self._turn, deadline, self._device, busy=busy):
            event, answer = threading.Event(), list[list[str]]()
            with self._sending:
                if not still():
                    return []
                if self.gone:
                    raise DeviceError(self._device, self.gone)
                self._number = number = self._number % 999_999_999 + 1
                self._waiting[number] = event, answer
                self._port.send(encode(letter, number, *values))
            event.wait(max(0.0, deadline - monotonic()))
            self._waiting.pop(number, None)
        if not answer:
            raise Unanswered(self._device, self.gone or "did not answer")
        kind, *fields = answer[0]
        if kind == "E":
            word = fields[0] if fields else ""
            raise DeviceError(self._device, REASONS.get(word, f'refuses with "{word}"'))
        return fields

    def _read(self, data: bytes, now: float) -> None:
        for line in self._splitter.feed(data):
            try:
                self._take(decode(line.rstrip(b"\r")), now)
            except NoLine as error:
                self.invalid += 1
                self.last = f'{error}: "{readable(line)}"'

    def _take(self, fields: list[str], now: float) -> None:
        if fields[0] == "S":
            self._on_sample(fields, now)
            return
        if fields[0] not in {"A", "E"} or len(fields) < 2 or not fields[1].isdecimal():
            raise NoLine("a line of no known kind")
        waiting = self._waiting.get(int(fields[1]))
        if waiting is not None and not waiting[0].is_set():
            waiting[1].append([fields[0], *fields[2:]])
            waiting[0].set()
