"""Questions to the object dictionary of one node: one at a time, each bounded, no write repeated."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from queue import Empty, SimpleQueue
from time import monotonic
from typing import TypeVar

from pmabench.base.errors import DeviceError
from pmabench_drivers.canbus import frames as f
from pmabench_drivers.shared.link import Unanswered, turn

ANSWER = 0.15
"""How long a node is given for an answer [s]."""
LONGEST = 256
"""No object that is read here is longer [bytes]."""

T = TypeVar("T")


class Refused(DeviceError):
    """The node ended the transfer with an abort code."""

    def __init__(self, device: str, message: str, channel: str, code: int) -> None:
        super().__init__(device, message, channel)
        self.code = code


class Objects:
    """The objects of one node. `kind` is that of `struct`: `B`, `b`, `H`, `h`, `I`, `i`."""

    def __init__(self, device: str, name: str, node: int, send: Callable[[int, bytes], None]) -> None:
        self._device, self._name, self._node, self._send = device, name, node, send
        self._answers: SimpleQueue[bytes] = SimpleQueue()
        self._lock = threading.Lock()
        self._owed = False

    def take(self, data: bytes) -> None:
        """An SDO answer of this node has come."""
        self._answers.put(data)

    def read(self, index: int, sub: int, kind: str, deadline: float) -> int:
        """A number."""
        data = self.read_bytes(index, sub, deadline)
        if len(data) != struct.calcsize(f"<{kind}"):
            raise self._error(index, sub, f"has {len(data)} bytes where {struct.calcsize(f'<{kind}')} are expected")
        [value] = struct.unpack(f"<{kind}", data)
        return int(value)

    def read_if_there(self, index: int, sub: int, kind: str, deadline: float) -> int | None:
        """A number, or None where the node has no such object."""
        try:
            return self.read(index, sub, kind, deadline)
        except Refused as error:
            if error.code in f.NO_OBJECT:
                return None
            raise

    def write(self, index: int, sub: int, kind: str, value: int, deadline: float) -> None:
        """Write a number once."""
        try:
            data = struct.pack(f"<{kind}", value)
        except struct.error:
            raise self._error(index, sub, f"cannot be set to {value}") from None
        with self._turn(deadline):
            self._ask(index, sub, f.download(index, sub, data), deadline, written=True)

    def set(self, index: int, sub: int, kind: str, value: int, deadline: float) -> None:
        """Write a number, unless the node holds it already, and read it back."""
        if self.read(index, sub, kind, deadline) == value:
            return
        self.write(index, sub, kind, value, deadline)
        held = self.read(index, sub, kind, deadline)
        if held != value:
            raise self._error(index, sub, f"holds {held} after {value} was written")

    def read_bytes(self, index: int, sub: int, deadline: float) -> bytes:
        """All bytes of an object."""
        with self._turn(deadline):
            answer = self._ask(index, sub, f.upload(index, sub), deadline, written=False)
            if not answer.segmented:
                return answer.data
            data, toggle, over = b"", 0, False
            while not over and len(data) <= LONGEST:
                self._put(f.next_segment(toggle))
                piece, over, code = self._wait(partial(_segment, toggle), index, sub, deadline)
                if code:
                    raise self._refused(index, sub, code)
                data, toggle = data + piece, toggle ^ 1
            return data

    # -- one question at a time ---------------------------------------------------------------------------------------

    def _turn(self, deadline: float) -> AbstractContextManager[None]:
        busy = f"{self._name} is still busy with what was asked before"
        return turn(self._lock, deadline, self._device, self._name, busy)

    def _ask(self, index: int, sub: int, question: bytes, deadline: float, *, written: bool) -> f.Answer:
        if self._owed:
            self._flush(deadline)
        self._drain()
        self._put(question)
        answer = self._wait(lambda raw: f.read_answer(raw, index, sub, written=written), index, sub, deadline)
        if answer.abort:
            raise self._refused(index, sub, answer.abort)
        return answer

    def _flush(self, deadline: float) -> None:
        """Ask for something else first, so that a late answer cannot belong to the next question."""
        self._drain()
        self._put(f.upload(f.DEVICE_TYPE, 0))
        self._wait(lambda raw: f.read_answer(raw, f.DEVICE_TYPE, 0, written=False), f.DEVICE_TYPE, 0, deadline)
        self._owed = False

    def _drain(self) -> None:
        while not self._answers.empty():
            self._answers.get()

    def _put(self, data: bytes) -> None:
        self._send(f.SDO_QUESTION + self._node, data)

    def _wait(self, read: Callable[[bytes], T], index: int, sub: int, deadline: float) -> T:
        until = min(deadline, monotonic() + ANSWER)
        while (left := until - monotonic()) > 0:
            try:
                return read(self._answers.get(timeout=left))
            except f.NoAnswer:
                continue
            except Empty:
                break
        self._owed = True
        asked = f"object {index:04X}h:{sub}; is node {self._node} on, and the bit rate right?"
        what = f"did not answer within {ANSWER:g} s about {asked}"
        raise Unanswered(self._device, f"{self._name} {what}", self._name)

    def _refused(self, index: int, sub: int, code: int) -> Refused:
        reason = f.ABORTS.get(code, "no reason that is known")
        message = f"{self._name} refuses object {index:04X}h:{sub}: {reason} (abort code {code:08X}h)"
        return Refused(self._device, message, self._name, code)

    def _error(self, index: int, sub: int, message: str) -> DeviceError:
        return DeviceError(self._device, f"{self._name}: object {index:04X}h:{sub} {message}", self._name)


def _segment(toggle: int, data: bytes) -> tuple[bytes, bool, int]:
    return f.read_segment(data, toggle)
