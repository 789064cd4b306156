"""The connection of a Festo device: the Modbus one, and the question who answers (function 43/14).

Imported by `open`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from pmabench.bench.interface import COMPUTER, EMULATED, Identity
from pmabench_drivers.modbus.adapter import Line, Serial, Signature

IDENTIFY = 43
BASIC, REGULAR = 1, 2


class NamedLine(Line):
    """A Modbus TCP connection whose other end also tells its names."""

    def __init__(self, device: str, address: str, timeout: float) -> None:
        super().__init__(device, address, unit_id=1, timeout=timeout, slowest=0.0, serial=Serial())

    def identification(self, deadline: float) -> dict[int, str]:
        """Objects 0 to 5 before `deadline` [s, monotonic]: maker, code, revision, address, product, model."""
        found: dict[int, str] = {}
        for code in (BASIC, REGULAR):
            answer = self._ask(partial(self._query, code), (IDENTIFY, code), deadline, "identification")
            for number, item in answer.information.items():
                data = item[0] if isinstance(item, list) else item
                found[number] = "".join(chr(byte) for byte in data if 32 <= byte < 127).strip()
        return found

    def identity(self, deadline: float) -> Identity:
        """Who answers, before `deadline` [s, monotonic]."""
        names = self.identification(deadline)
        model = names.get(4) or names.get(1, "")
        simulated = model.startswith(EMULATED)
        return Identity(names.get(0, ""), model, "", names.get(2, ""), simulated=simulated, clock=COMPUTER)

    def _query(self, code: int) -> Any:
        return self._client.read_device_information(read_code=code, object_id=0, device_id=self._unit_id)

    def _belongs(self, answer: Any, wanted: Signature) -> bool:
        if wanted[0] != IDENTIFY or answer.isError():
            return super()._belongs(answer, wanted)
        return (answer.function_code, getattr(answer, "read_code", 0)) == wanted
