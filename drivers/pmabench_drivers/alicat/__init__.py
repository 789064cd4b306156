"""Alicat PC and PCD pressure controllers, over ASCII or Modbus RTU on a serial line.

`options`: what the bench file says, and what a reading says; `ascii_link`, `modbus_link`: the two protocols behind the
same few methods; here: the device interface; `emulator`, `emulated_controller`: the device for `pmabench emulate`.

Sources: Alicat, manual of standard flow and pressure devices, 02/2023 (Modbus registers, special commands, status bits;
ASCII commands); Apex/Alicat PC manual, page 22 (set-points, data frame). The list of columns is read as devices with
firmware 6v21 to 10v20 are known to send it.

It has no watchdog: a controller that hears nothing keeps its last set-point. One thread polls and steps ramps and
sines; calls and polls take turns on the one line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from time import monotonic

from pmabench.base.clock import Clock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import DeviceRecord, Identity, OutputRecord
from pmabench_drivers.alicat.ascii_link import AsciiLink
from pmabench_drivers.alicat.modbus_link import ModbusLink
from pmabench_drivers.alicat.options import ASCII, NO_VALUE, OVER, Options, Reading, read_options, trouble
from pmabench_drivers.shared.device import Controlled
from pmabench_drivers.shared.link import JOIN, Still

Link = AsciiLink | ModbusLink
CALL = 0.18
"""Longest time that a call takes [s]; the guard gives up at 0.2 s."""
OPEN = 1.9


class AlicatController(Controlled):
    """A pressure controller: measures `pressure` and `set_point`, takes the output `pressure`.

    A set-point at or below the output's safe value vents: over Modbus with the exhaust of a dual-valve controller.
    """

    emulator = "pmabench_drivers.alicat.emulator"
    read_options = staticmethod(read_options)
    _options: Options

    def __init__(self, device: DeviceRecord, clock: Clock) -> None:
        super().__init__(device, clock)
        self._inputs = [channel.input for channel in device.channels]
        self._link: Link | None = None
        self._reading: Reading | None = None
        """Reading in the answer to a step, in this turn of the thread."""

    # -- life -----------------------------------------------------------------------------------------------------

    def open(self) -> Identity:
        """Connect and learn what the device says of itself; nothing is commanded."""
        self.close()
        kind = AsciiLink if self._options.protocol == ASCII else ModbusLink
        link = self._link = kind(self._device.name, self._device.address, self._options, self._clock)
        with self._closed_on_error():
            return link.open(monotonic() + OPEN)

    def close(self) -> None:
        """End polling and let go of the port; the device keeps its set-point."""
        self._following.clear()
        self._streaming = False
        link, self._link = self._link, None
        self._cycle.stop(JOIN)
        if link is not None:
            link.close()

    # -- samples --------------------------------------------------------------------------------------------------

    def _fastest(self) -> float:
        return min(self._options.rate, self._opened().fastest)

    def _tick(self) -> None:
        """One turn of the thread: the next step of a segment, whose answer may be a reading, or a poll."""
        if (link := self._link) is None:
            return
        self._reading = None
        failure = self._step()
        reading = self._reading
        try:
            if self._streaming and reading is None and failure is None:
                reading = link.poll(monotonic() + self._options.timeout)
        except DeviceError as error:
            failure = error
        if reading is not None:
            if wrong := trouble(reading.status, exhausting=link.exhausting):
                failure = self._error(wrong)
            if self._streaming and not reading.status & NO_VALUE:
                self._take(reading)
        elif failure is None:
            return  # nothing was learned
        self._cycle.note(failure)

    def _take(self, reading: Reading) -> None:
        values = {"pressure": math.nan if OVER in reading.status else reading.pressure, "set_point": reading.set_point}
        self._keep([values[name] for name in self._inputs], reading.asked, reading.answered)

    # -- commands -------------------------------------------------------------------------------------------------

    def write(self, output: str, value: float) -> None:
        """Command a set-point once; what the device then holds decides. At or below the safe value it vents."""
        record = self._output(output)
        self._following.pop(output, None)
        link, deadline = self._opened(), monotonic() + CALL
        if self._vents(record, value):
            link.vent(value, deadline, record.resolution / 2)
        else:
            link.command(value, deadline, record.resolution / 2)

    def read_back(self, output: str) -> float:
        """The set-point that the device holds."""
        self._output(output)
        return self._opened().held(monotonic() + CALL)

    def held(self) -> Mapping[str, float | str]:
        """Unit and source of its set-point, as it says itself over ASCII from firmware 10v05 on; before, the unit.

        It has no watchdog and reports no uptime: a restart shows in its set-point, which `read_back` asks for.
        """
        return self._opened().reported(monotonic() + CALL)

    def _refuse_value(self, output: str, value: float) -> None:
        """Any number can be sent; the device and the guard have their limits."""

    def _send_step(self, output: str, value: float, still: Still, *, last: bool) -> None:
        """The set-point of this moment; the last one vents where it is low enough."""
        record, link = self._outputs[output], self._opened()
        vents = last and self._vents(record, value)
        send = link.vent if vents else link.command
        deadline = monotonic() + (CALL if vents else self._options.timeout)
        self._reading = send(value, deadline, record.resolution / 2, still)

    def _vents(self, record: OutputRecord, value: float) -> bool:
        """Whether a set-point is that of the safe state, or beyond it."""
        return value <= float(record.scale.to_raw(record.safe)) + 1e-9

    def _opened(self) -> Link:
        if self._link is None:
            raise self._error("is not open")
        return self._link
