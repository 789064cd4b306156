"""The port of a board: one thread reads every line and gives answers to whoever asked by their number; knows no bench.

A question is sent once. It has a number that no other has for a long time, so a late answer never belongs to another.
"""

from __future__ import annotations

import contextlib
import random
import threading
from collections.abc import Callable
from time import monotonic
from typing import Any

from pmabench.base.errors import DeviceError
from pmabench_drivers.serial_ascii.lines import Splitter
from pmabench_drivers.serial_ascii.pattern import readable
from pmabench_drivers.serial_line_daq.wire import END, REASONS, NoLine, decode, encode
from pmabench_drivers.serial_port import hand_over

PIECE = 0.02
"""Longest single wait for bytes [s]."""
PUSH = 0.05
"""Longest time to hand a line to the port [s]."""
JOIN = 0.15


class Unanswered(DeviceError):
    """No answer came: whether the command was carried out is not known."""


class Link:
    """An open port; `on_sample` gets the fields of each `S` line, in the reading thread."""

    def __init__(self, device: str, address: str, baud: int, on_sample: Callable[[list[str]], None]) -> None:
        import serial

        self._device, self._address, self._on_sample = device, address, on_sample
        try:
            self._port: Any = serial.Serial(address, baudrate=baud, timeout=PIECE, exclusive=True)
        except (OSError, ValueError) as error:
            busy = "temporarily unavailable" in str(error) or "exclusively lock" in str(error)
            why = "another program has it open" if busy else getattr(error, "strerror", None) or str(error)
            raise DeviceError(device, f"cannot open {address}: {why}") from None
        self._turn, self._sending = threading.Lock(), threading.Lock()
        self._waiting: dict[int, tuple[threading.Event, list[list[str]]]] = {}
        self._number = random.randrange(1 << 20)
        self._ended = False
        self.gone = ""
        """Why the port is lost."""
        self.spoilt = 0
        """Lines that could not be read."""
        self.last = ""
        """The last one of them."""
        self._thread = threading.Thread(target=self._read, name=f"line-daq {device}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Let go of the port; harmless when repeated."""
        self._ended = True
        if threading.current_thread() is not self._thread:
            self._thread.join(JOIN)
        with contextlib.suppress(OSError):
            self._port.close()

    def ask(
        self,
        deadline: float,
        letter: str,
        *values: int,
        still: Callable[[], bool] = lambda: True,
        aside: bool = False,
    ) -> list[str]:
        """What the board answers before `deadline` [s, monotonic]; nothing is sent if `still()` is false by then.

        One question is under way at a time: a board has little room for what comes in. One that goes `aside` does not
        wait for its turn. Raises DeviceError where the board refuses, Unanswered where nothing comes.
        """
        what = f"the question {letter}"
        taken = aside or self._turn.acquire(timeout=max(0.0, deadline - monotonic()))
        if not taken:
            raise DeviceError(self._device, f"has not answered yet what was asked before; {what} was not sent")
        try:
            event, answer = threading.Event(), list[list[str]]()
            with self._sending:
                if not still():
                    return []
                self._number = number = self._number % 999_999_999 + 1
                self._waiting[number] = event, answer
                self._send(encode(letter, number, *values))
            event.wait(max(0.0, deadline - monotonic()))
            self._waiting.pop(number, None)
        finally:
            if not aside:
                self._turn.release()
        if not answer:
            raise Unanswered(self._device, f"lost {self._address}: {self.gone}" if self.gone else "did not answer")
        kind, *fields = answer[0]
        if kind == "E":
            word = fields[0] if fields else ""
            raise DeviceError(self._device, REASONS.get(word, f'refuses with "{word}"'))
        return fields

    def _send(self, line: bytes) -> None:
        if self.gone or self._ended:
            raise DeviceError(self._device, f"lost {self._address}: {self.gone or 'closed'}")
        try:
            hand_over(self._port, line, PUSH)
        except (OSError, TypeError) as error:
            raise DeviceError(self._device, f"cannot send to {self._address}: {_strerror(error)}") from None

    def _read(self) -> None:
        splitter = Splitter(END, whole=True)  # what is not whole has a wrong checksum
        while not self._ended:
            try:
                data = self._port.read(1)
                data += self._port.read(self._port.in_waiting)
            except (OSError, TypeError) as error:
                self.gone = _strerror(error)
                for event, _answer in list(self._waiting.values()):
                    event.set()
                return
            for line in splitter.feed(data):
                try:
                    fields = decode(line.rstrip(b"\r"))
                    self._take(fields)
                except NoLine as error:
                    self.spoilt += 1
                    self.last = f'{error}: "{readable(line)}"'

    def _take(self, fields: list[str]) -> None:
        if fields[0] == "S":
            self._on_sample(fields)
            return
        if fields[0] not in {"A", "E"} or len(fields) < 2 or not fields[1].isdecimal():
            raise NoLine("a line of no known kind")
        waiting = self._waiting.get(int(fields[1]))
        if waiting is not None and not waiting[0].is_set():
            waiting[1].append([fields[0], *fields[2:]])
            waiting[0].set()


def _strerror(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
