"""One connection to a Modbus device: transactions that end in time; the only module that imports pymodbus.

The adapter adds to the library: no wait beyond the caller's deadline, however slowly bytes arrive; no retry; every
library error as a `DeviceError`; and no answer taken for that of another request. Over TCP a lost answer closes the
connection, and the next call opens a new one. A serial line has neither connections nor numbers in its frames: there a
lost answer is noted, and until the device's slowest time has passed no request is sent whose answer would look the
same. Exception codes: Modbus Application Protocol 1.1b3, section 7. `NamedLine` also identifies the device (function
43/14).
"""

from __future__ import annotations

import contextlib
import logging
import math
import select
import socket
import struct
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from time import monotonic, sleep
from typing import Any

from pymodbus.client import ModbusSerialClient, ModbusTcpClient  # noqa: TID253  (this module is imported by `open`)
from pymodbus.exceptions import ConnectionException, ModbusException  # noqa: TID253
from pymodbus.framer import FramerRTU  # noqa: TID253

from pmabench.base.errors import Busy, DeviceError, NotSent
from pmabench.bench.interface import COMPUTER, Identity
from pmabench_drivers.modbus.registers import BIT_TABLES, READ
from pmabench_drivers.shared.link import Still, Unanswered, always, reason, turn, who

for _name in ("pymodbus.logging", "pymodbus_logging"):
    logging.getLogger(_name).setLevel(logging.CRITICAL)  # its messages are also raised here

PORT = 502
"""Default port of Modbus TCP."""
SHOWN = 0.005
"""Pause between two checks of a device's value after a command [s]."""
GIVES_WAY, PATIENT, LONGEST = 0.001, 0.1, 0.3
"""Pause between two checks whether a sample may be read; wait until it precedes requests that can wait, and all [s]."""
LONGEST_FRAME = 512
"""Largest number of late bytes that are searched for an answer: two frames."""
PIECE = 0.005
"""Longest wait for bytes of a serial port before the deadline is checked again [s]."""
EXCEPTIONS = {
    1: "it does not know this function",
    2: "it has no such address",
    3: "it does not accept this value or number of registers",
    4: "it failed while doing it",
    5: "it has accepted this and needs long for it",
    6: "it is busy",
    7: "it refused to do this",
    8: "its memory has a parity error",
    10: "the gateway has no path to it",
    11: "the gateway got no answer from it",
}
"""Exception code -> what the device says with it."""
NO_REFUSAL = (5, 6, 10, 11)
"""Of those, the ones after which it may be carried out, or the next time."""

BUSY, AGAIN = 6, 0.02
"""Exception of a device that does something else first; time after which it is asked again [s]."""


CALLS = {
    "holding": "read_holding_registers",
    "input": "read_input_registers",
    "coil": "read_coils",
    "discrete": "read_discrete_inputs",
}
"""Table -> name of the library's method that reads it."""
SIGNATURES: dict[int, Callable[[Any], tuple[int, ...]]] = {
    **dict.fromkeys((1, 2), lambda answer: (len(answer.bits),)),
    **dict.fromkeys((3, 4), lambda answer: (len(answer.registers),)),
    5: lambda answer: (answer.address, int(answer.bits[0])),
    6: lambda answer: (answer.address, answer.registers[0]),
    **dict.fromkeys((15, 16), lambda answer: (answer.address, answer.count)),
}
"""Function code -> values that distinguish its answer from others."""
FAILED = 0x80
"""Added to the function code of a refusal."""
LAST_READ = 4
"""Function codes up to this one read."""

Signature = tuple[int, ...]
"""Values that distinguish an answer from others: function code, and number of bytes or address."""
IDENTIFY = 43
BASIC, REGULAR = 1, 2


class _Tcp(ModbusTcpClient):
    """The library's client, with a `recv` that respects the deadline of the whole call."""

    deadline = 0.0
    why = ""

    def connect(self) -> bool:
        """Connect; if that fails, `why` has the reason."""
        if self.socket is None:
            try:
                target = self.comm_params.host, self.comm_params.port
                self.socket = socket.create_connection(target, timeout=self.comm_params.timeout_connect)
                self.socket.setblocking(False)
                self._ready = select.poll()
                self._ready.register(self.socket, select.POLLIN)
            except OSError as error:
                self.why = f"{reason(error).lower()}: is it switched on, and is the address right?"
        return self.socket is not None

    def recv(self, size: int | None) -> bytes:
        """The available bytes, or none at the deadline."""
        connection, left = self.socket, self.deadline - monotonic()
        if connection is None:
            raise ConnectionException("the connection was closed")
        if left <= 0 or not self._ready.poll(1e3 * left):
            return b""
        if not (data := connection.recv(size or 4096)):
            raise ConnectionException("the device closed the connection")
        return data

    def waiting(self) -> bytes:
        """Nothing: after a lost answer the connection is closed, so no bytes are left over."""
        return b""

    def cut(self) -> None:
        """Close the connection during a call that waits for it."""
        if (connection := self.socket) is not None:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)


class _Rtu(ModbusSerialClient):
    """The same for a serial line."""

    deadline = 0.0
    why = "is it there, and does no other program use it?"

    def connect(self) -> bool:
        """Open the port exclusively."""
        opened = super().connect()
        if opened and self.socket is not None:
            self.socket.timeout = PIECE
        return opened

    def recv(self, size: int | None) -> bytes:
        """The available bytes, or none at the deadline."""
        while self.socket is not None and monotonic() < self.deadline:
            if data := bytes(self.socket.read(1)):
                return data + bytes(self.socket.read(self.socket.in_waiting))
        return b""

    def waiting(self) -> bytes:
        """The available bytes."""
        with contextlib.suppress(OSError, TypeError):
            return bytes(self.socket.read(self.socket.in_waiting)) if self.socket is not None else b""
        return b""

    def cut(self) -> None:
        """No effect: calls on a serial port end by themselves."""


@dataclass(frozen=True)
class Question:
    """One request: how it is sent, what its answer looks like, until when [s, monotonic], and what it is about."""

    send: Callable[[], Any]
    wanted: Signature
    deadline: float
    what: str
    still: Still = always
    sample: bool = False

    @property
    def passing(self) -> bool:
        """Whether it is a sample or a step of a ramp: the next one comes soon enough."""
        return self.sample or self.still is not always


class Line:
    """The connection of one device at `address` (HOST, HOST:PORT, or the path of a serial port), used by any thread.

    `serial`: settings of a serial line, by the names of `serial.Serial`.
    """

    def __init__(
        self, device: str, address: str, unit_id: int, timeout: float, slowest: float = 0.0, serial: Any = None
    ) -> None:
        self._device, self._address = device, address
        self._unit_id, self._timeout, self._slowest = unit_id, timeout, slowest
        self._lock = threading.Lock()
        self._closed = False
        self._owed: list[tuple[Signature, float]] = []
        self._late = b""
        """Bytes received during the wait for late answers."""
        self._overdue = False
        self._calls = set[object]()
        """Calls that wait for their turn or are in progress; samples wait for them."""
        self.quickest, self.heard, self.asked, self.called = math.inf, -math.inf, -math.inf, -math.inf
        """Shortest time of an answer [s]; when the last one came, when a sample was requested, and when a caller other
        than the polling thread last called [s, monotonic].
        """
        self.connections = 0
        """Number of connections so far: a new connection may lead to another device."""
        host, colon, port = address.rpartition(":")
        self.is_serial = address.startswith("/")
        self._client: _Tcp | _Rtu
        if self.is_serial:
            self._client = _Rtu(address, timeout=timeout, retries=0, **(serial or {}))
        else:
            place = (host, int(port)) if colon else (address, PORT)
            self._client = _Tcp(place[0], port=place[1], timeout=timeout, retries=0)

    def close(self) -> None:
        """Close the connection for good; may be called again. A call that still waits for its turn fails."""
        self._closed = True
        self._client.cut()
        with self._lock:
            self._client.close()  # type: ignore[no-untyped-call]

    def read(
        self, table: str, address: int, count: int, deadline: float, what: str = "", *, sample: bool = False
    ) -> list[int]:
        """`count` registers (or bits) of a table from `address` on, before `deadline` [s, monotonic].

        A `sample` lets all other calls go first; `asked` is the time at which it was requested.
        """
        call, unit = getattr(self._client, CALLS[table]), self._unit_id
        bits = table in BIT_TABLES
        size = (count + 7) // 8 * 8 if bits else count
        ask = lambda: call(address, count=count, device_id=unit)  # noqa: E731
        answer = self._ask(Question(ask, (READ[table], size), deadline, what, sample=sample))
        return [int(bit) for bit in answer.bits[:count]] if bits else answer.registers

    def write(
        self, function: int, address: int, words: Sequence[int], deadline: float, what: str = "", still: Still = always
    ) -> None:
        """Write registers (functions 6, 16) or coils (5, 15) once; raises `Unanswered` if the outcome is unknown.

        Never waits for an older answer: its echo holds the address, and a vent cannot wait. Nothing is sent if
        `still()` is false by the time the line is free.
        """
        unit = self._unit_id
        calls: dict[int, Callable[[], Any]] = {
            5: lambda: self._client.write_coil(address, bool(words[0]), device_id=unit),
            6: lambda: self._client.write_register(address, words[0], device_id=unit),
            15: lambda: self._client.write_coils(address, [bool(word) for word in words], device_id=unit),
            16: lambda: self._client.write_registers(address, list(words), device_id=unit),
        }
        echo = words[0] if function in {5, 6} else len(words)
        self._ask(Question(calls[function], (function, address, echo), deadline, what, still))

    def overrule(
        self,
        function: int,
        address: int,
        words: Sequence[int],
        deadline: float,
        what: str = "",
        shown_at: int | None = None,
        mask: int = 0xFFFF,
        watch: float = 0.0,
    ) -> None:
        """Write, and write again while the device shows another value.

        A command that another connection was sending when it was cut may be carried out after the first write: the
        value is checked for `watch` seconds. `shown_at`: the register that shows it, if that is another one;
        `mask`: the bits that are compared and written, the others stay as they are shown.
        """
        self.write(function, address, words, deadline, what)
        table, where = "coil" if function in {5, 15} else "holding", address if shown_at is None else shown_at
        enough = monotonic() + watch
        while True:
            sleep(min(watch, SHOWN))
            try:
                held = self.read(table, where, len(words), deadline, what)
            except DeviceError:
                return  # written, but cannot be read; whether the bench is safe is measured
            wanted = [word & mask | before & ~mask for word, before in zip(words, held, strict=True)]
            if wanted != held:
                self.write(function, address, wanted, deadline, what)
            elif monotonic() >= enough:
                return

    def cut(self) -> bool:
        """End a call that hangs in another thread; the next one reconnects. Returns whether there was one."""
        under_way = self._lock.locked()
        self._client.cut()
        if not self.is_serial and self._lock.acquire(blocking=False):
            self._client.close()  # type: ignore[no-untyped-call]
            self._lock.release()
        return under_way

    # -- one transaction ------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _turn(self, deadline: float, what: str, *, sample: bool) -> Iterator[None]:
        """The line for one request; samples wait for calls, which would otherwise never get a slow line."""
        call = object()
        if sample:
            begun = monotonic()
            while self._calls and monotonic() < min(begun + LONGEST, deadline):
                self._overdue = monotonic() > begun + PATIENT
                sleep(GIVES_WAY)
        else:
            self._calls.add(call)
        try:
            with turn(self._lock, deadline, self._device, what):
                self._overdue = self._overdue and not sample
                yield
        finally:
            self._calls.discard(call)

    def let_samples(self) -> None:
        """Called before a request without hurry: let a sample go first that has waited long."""
        until = monotonic() + PATIENT
        while self._overdue and monotonic() < until:
            sleep(GIVES_WAY)

    def _ask(self, question: Question) -> Any:
        """As `_ask_once`; sent again while the device answers that it is busy, as the specification asks for.

        A value that is written twice is the same value.
        """
        while True:
            try:
                return self._ask_once(question)
            except Busy:
                if question.passing or monotonic() + AGAIN >= question.deadline:
                    raise
                sleep(AGAIN)

    def _ask_once(self, question: Question) -> Any:
        """Send one request and return its answer; errors of the library are raised as DeviceError."""
        wanted, deadline, what, sample = question.wanted, question.deadline, question.what, question.sample
        if not question.passing:
            self.called = monotonic()
        with self._turn(deadline, what, sample=sample):
            if self._closed:
                raise DeviceError(self._device, "was closed", what)
            if not self._client.connected:
                self._connect(deadline, what)
            if self._owed:
                self._came(self._client.waiting())  # the library drops it before it sends
            if self._owed and wanted[0] <= LAST_READ:
                self._wait_until_clean(wanted, deadline, what)
            now = monotonic()
            if (limit := min(deadline, now + self._timeout)) <= now:
                raise DeviceError(self._device, "no time was left to ask", what)
            if not question.still():
                return None
            self._client.deadline = limit
            self._client.comm_params.timeout_connect = max(limit - now, 0.001)
            self.asked = now if sample else self.asked
            try:
                answer = question.send()
                while not self._belongs(answer, wanted):
                    answer = self._next_answer()
            except (ModbusException, OSError, TypeError, ValueError, IndexError, struct.error) as error:
                self._lost(wanted)
                raise Unanswered(self._device, self._why(error, limit), what) from None
            self.heard = monotonic()
            self.quickest = min(self.quickest, self.heard - now)
            if answer.function_code > FAILED:
                if owed := any(signature[0] == wanted[0] for signature, _until in self._owed):
                    self._lost(wanted)  # it may be the answer that is owed: then this one's is still to come
                code = answer.exception_code
                words = EXCEPTIONS.get(code, "which the specification does not define")
                certain = not owed and wanted[0] > LAST_READ and code not in NO_REFUSAL
                kind = NotSent if certain else Busy if code == BUSY else DeviceError
                raise kind(self._device, f"answers with exception {code}: {words}", what)
            return answer

    def _next_answer(self) -> Any:
        """On a serial line, the next answer after one that belongs to an older request."""
        if not self.is_serial or monotonic() >= self._client.deadline:
            raise ModbusException("no other answer came")
        return self._client.transaction.sync_get_response(self._unit_id, 0)

    def _belongs(self, answer: Any, wanted: Signature) -> bool:
        """Whether an answer belongs to this request; a late answer to an earlier one is removed from the list."""
        if (function := answer.function_code) > FAILED:
            return bool(function == wanted[0] | FAILED)
        signature: Signature = (function, *SIGNATURES.get(function, lambda _answer: ())(answer))
        if signature == wanted:
            return True
        self._owed = [item for item in self._owed if item[0] != signature]
        return False

    def _lost(self, wanted: Signature) -> None:
        if self.is_serial:
            self._late = b""
            self._owed.append((wanted, monotonic() + self._slowest))
        else:
            self._client.close()  # type: ignore[no-untyped-call]

    def _wait_until_clean(self, wanted: Signature, deadline: float, what: str) -> None:
        """Wait while a late answer may still arrive that could be taken for the answer to this request."""
        while True:
            self._owed = [item for item in self._owed if item[1] > monotonic()]
            if all(signature != wanted for signature, _until in self._owed):
                return
            if monotonic() >= deadline:
                why = "so that a late answer to the last question is not taken for a new one"
                raise DeviceError(self._device, f"is not asked again yet, {why}", what)
            self._client.deadline = min(deadline, self._owed[0][1])
            with contextlib.suppress(OSError, TypeError):
                self._came(self._client.recv(None))

    def _came(self, data: bytes) -> None:
        """Remove late answers found in the received bytes from the list."""
        self._late = (self._late + data)[-LONGEST_FRAME:]
        self._owed = [item for item in self._owed if not self._has_come(item[0])]

    def _has_come(self, signature: Signature) -> bool:
        """Whether the late answer to a read request is in the received bytes."""
        function, size = signature[:2]
        if function > LAST_READ:
            return False
        head = bytes((self._unit_id, function, size // 8 if function in {1, 2} else 2 * size))
        start = self._late.find(head)
        frame = self._late[start : start + head[2] + 5] if start >= 0 else b""
        whole = len(frame) == head[2] + 5
        return whole and FramerRTU.check_CRC(frame[:-2], int.from_bytes(frame[-2:], "big"))

    def _connect(self, deadline: float, what: str) -> None:
        self._client.comm_params.timeout_connect = max(0.001, min(deadline - monotonic(), 2.0))
        if not self._client.connect():
            raise DeviceError(self._device, f"no connection to {self._address}: {self._client.why}", what)
        self.connections += 1

    def _why(self, error: Exception, limit: float) -> str:
        if isinstance(error, ConnectionException | OSError) and monotonic() < limit:
            if self.is_serial:
                self._client.close()  # type: ignore[no-untyped-call]
            return f"the connection to {self._address} was lost"
        if monotonic() >= limit - 1e-3:
            return f"no answer from {self._address} within {self._timeout:g} s"
        return f"an answer that makes no sense from {self._address}"


class NamedLine(Line):
    """A Modbus TCP connection to a device that can identify itself."""

    def __init__(self, device: str, address: str, timeout: float) -> None:
        super().__init__(device, address, 1, timeout)

    def identification(self, deadline: float) -> dict[int, str]:
        """Objects 0 to 5 before `deadline` [s, monotonic]: maker, code, revision, address, product, model."""
        found: dict[int, str] = {}
        for code in (BASIC, REGULAR):
            query = partial(self._client.read_device_information, read_code=code, object_id=0, device_id=self._unit_id)
            answer = self._ask(Question(query, (IDENTIFY, code), deadline, "identification"))
            for number, item in answer.information.items():
                data = item[0] if isinstance(item, list) else item
                found[number] = "".join(chr(byte) for byte in data if 32 <= byte < 127).strip()
        return found

    def read_again(self, address: int, count: int, deadline: float, what: str) -> list[int]:
        """Holding registers; read once more if no answer came in time, as reading moves nothing."""
        try:
            return self.read("holding", address, count, deadline, what)
        except Unanswered:
            if monotonic() >= deadline:
                raise
            return self.read("holding", address, count, deadline, what)

    def identity(self, deadline: float) -> Identity:
        """Identity of the device, before `deadline` [s, monotonic]."""
        names = self.identification(deadline)
        return who(names.get(0, ""), names.get(4) or names.get(1, ""), firmware=names.get(2, ""), clock=COMPUTER)

    def _belongs(self, answer: Any, wanted: Signature) -> bool:
        if wanted[0] != IDENTIFY or answer.isError():
            return super()._belongs(answer, wanted)
        return (answer.function_code, getattr(answer, "read_code", 0)) == wanted
