"""An emulated device of Festo: Modbus TCP, and the question who answers (function 43/14)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pmabench_drivers.emulator import frames
from pmabench_drivers.emulator.log import CommandLog
from pmabench_drivers.emulator.modbus_server import Answering, Send, TcpDevice

IDENTIFY = b"\x2b\x0e"


class NamedDevice(TcpDevice):
    """Also tells its names, objects 0 to 5; `hear` is called for that question, as for any communication."""

    def __init__(
        self, registers: Answering, names: Sequence[str], hear: Callable[[], None], log: CommandLog, port: int
    ) -> None:
        super().__init__(registers, 1, log, port)
        self._names, self._hear = names, hear

    def answer(self, pdu: bytes, connection: int, send: Send) -> None:
        """Also function 43/14, which is met by the faults of the link that are about connections."""
        if pdu[:2] != IDENTIFY:
            super().answer(pdu, connection, send)
            return
        self._hear()
        fault = self.faults.next()
        if fault.kind in {"hang-up", "reset"}:
            raise ConnectionAbortedError(fault.kind)
        if fault.kind == "silence":
            return
        if len(pdu) != 4 or pdu[2] not in {1, 2}:
            send(frames.refusal(0x2B, frames.VALUE), fault)
            return
        objects = self._names[:3] if pdu[2] == 1 else self._names
        body = b"".join(bytes([i, len(text)]) + text.encode("ascii") for i, text in enumerate(objects))
        send(bytes([0x2B, 0x0E, pdu[2], 0x82, 0, 0, len(objects)]) + body, fault)
