"""One CiA 406 linear transducer, as the Temposonics E-Series has it: position, velocity and status in one PDO.

Steps come from the device: position in units of 0.001 um, velocity in units of 0.01 mm/s (objects 6005h:1 and :2; where
there is no 6005h, position by 6501h). Source: E-Series CANopen manual; CiA 406.
"""

from __future__ import annotations

from pmabench_drivers.canbus import frames as f
from pmabench_drivers.canbus.node import Node, Send

POSITIONS = (f.mapping(0x6020, 1, 32), f.mapping(0x6004, 0, 32))
"""How the position is mapped: of one of several magnets, or of the only one."""
VELOCITY, STATUS = f.mapping(0x6030, 1, 16), f.mapping(0x6400, 1, 8)
STEPS, MEASURING_STEP, ALARMS = 0x6005, 0x6501, 0x6503
NO_MAGNET = 1


class Transducer(Node):
    """A transducer of the bus; `position` [um] and `velocity` [mm/s] are the newest."""

    profile = 406

    def __init__(self, device: str, name: str, number: int, send: Send) -> None:
        super().__init__(device, name, number, send)
        self.position = self.velocity = 0.0
        self.has_velocity = False
        self._step = self._speed_step = 0.0

    def set_up(self, deadline: float) -> None:
        """Read its steps, and let it answer to each SYNC."""
        alarms = self.objects.read_if_there(ALARMS, 0, "H", deadline)
        if alarms is not None and alarms & NO_MAGNET:
            raise self.error("says that its magnet is missing")
        step = self.objects.read_if_there(STEPS, 1, "I", deadline)
        if step is None:
            step = self.objects.read_if_there(MEASURING_STEP, 0, "I", deadline)
        if not step:
            raise self.error("does not tell its measuring step (objects 6005h:1 and 6501h)")
        self._step = step * 1e-3
        self._speed_step = (self.objects.read_if_there(STEPS, 2, "I", deadline) or 0) * 0.01
        entries = self._mapping(f.TPDO_MAPPING, deadline)
        if not entries or entries[0] not in POSITIONS:
            shown = f"{entries[0]:08X}h" if entries else "nothing"
            raise self.error(f"its first PDO begins with {shown}, and a position (60200120h or 60040020h) is expected")
        self.has_velocity = self._speed_step > 0 and entries[1:2] == [VELOCITY]
        self.mapped.clear()
        self.transmit(0, [], self._take, deadline)

    def _take(self, data: bytes) -> bool:
        if not 4 <= len(data) <= 8 or (self.has_velocity and len(data) < 6):
            return False
        self.position = int.from_bytes(data[:4], "little", signed=True) * self._step
        if self.has_velocity:
            self.velocity = int.from_bytes(data[4:6], "little", signed=True) * self._speed_step
        return True
