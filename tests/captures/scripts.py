"""What is done to each kind of device while its exchange is captured, and again while it is replayed."""

import random
import time
from contextlib import nullcontext
from dataclasses import replace
from unittest.mock import patch

from pmabench_drivers.alicat import AlicatController
from pmabench_drivers.canbus import CanBus
from pmabench_drivers.dataq import Dataq
from pmabench_drivers.festo_cmmt import FestoCmmt
from pmabench_drivers.festo_cpx_e import FestoCpxE
from pmabench_drivers.ild1420 import Ild1420
from pmabench_drivers.labjack import LabJack
from pmabench_drivers.modbus import ModbusDevice
from pmabench_drivers.ni_daq import NiDaq
from pmabench_drivers.ni_daq.connection import Connection
from pmabench_drivers.serial_ascii import SerialIndicator
from pmabench_drivers.serial_line_daq import SerialLineDaq
from pmabench_drivers.shared.link import Cycle

from pmabench.base.clock import RealClock
from tests.drivers.alicat.rigs import controller
from tests.drivers.can.rigs import bus
from tests.drivers.common import until
from tests.drivers.dataq.rigs import daq
from tests.drivers.festo.rigs import terminal
from tests.drivers.festo_cmmt.rigs import drive
from tests.drivers.ild1420.rigs import laser
from tests.drivers.labjack.rigs import t7
from tests.drivers.ni.rigs import daq as daq_of_tasks
from tests.drivers.serial_line_daq.rigs import board
from tests.drivers.wires.rigs import cell, regulator


def outputs(device, output, valve, interlock, value, watchdog=0.5):
    """A whole use of a device with outputs: armed, energised, commanded, read, disarmed."""
    yield device.arm_watchdog(watchdog)
    device.feed_watchdog()
    device.switch(valve, on=True)
    yield device.is_on(valve)
    device.write(output, value)
    yield device.read_back(output)
    yield device.level(interlock)
    if isinstance(device, ModbusDevice) and not isinstance(device, LabJack):
        yield from sampled(device)
    device.write(output, 0.0)
    device.switch(valve, on=False)
    yield device.is_on(valve)
    device.disarm_watchdog()


def sampled(device):
    """One sample of a device that is asked for its samples."""
    if isinstance(device, ModbusDevice):
        device._streaming = True  # as while its thread asks
    device._tick()
    if isinstance(device, ModbusDevice):
        device._streaming = False
    for name, column in sorted(device.collect().columns.items()):
        yield name, [round(value, 4) for value in column]


def regulated(device):
    """A regulator without a watchdog."""
    device.write("pressure", 200.0)
    yield device.read_back("pressure")
    device.write("pressure", 0.0)
    yield device.read_back("pressure")


def moved(device, output, value, interlock):
    """A whole use of a drive: armed, ready, sent to a place, a cycle, stopped, disarmed."""
    yield device.arm_watchdog(0.5)
    device.feed_watchdog()
    if interlock:
        yield device.level(interlock)
    device.write(output, value)
    yield device.read_back(output)
    device._every = 1  # as while it samples
    device._tick()
    row = {}
    assert until(lambda: row.update(device.collect().columns) or all(len(column) for column in row.values()))
    yield list(row["displacement"])
    device._every = 0
    device.halt(output)
    device.disarm_watchdog()


def tasked(device):
    """A whole use of a device of tasks: valve, output and input line, and a stream that is set up and ended."""
    device.switch("port1/line0", on=True)
    yield device.is_on("port1/line0")
    device.write("ao0", 2.5)
    yield round(device.read_back("ao0"), 3)
    yield device.level("port0/line0")
    yield device.start(500.0)
    device.stop()
    device.write("ao0", 0.0)
    device.switch("port1/line0", on=False)
    yield device.is_on("port1/line0")


def streamed(rate):
    """A device that sends by itself, for a moment."""

    def use(device):
        yield device.start(rate)
        time.sleep(0.1)
        device.stop()
        for name, column in sorted(device.collect().columns.items()):
            yield name, len(column) > 5, {round(value, 2) for value in column}

    return use


SCRIPTS = {
    "modbus-tcp": (ModbusDevice, regulator, False, lambda d: outputs(d, "pressure", "dump", "e_stop", 250.0)),
    "modbus-rtu": (
        ModbusDevice,
        lambda path: regulator(str(path), {"baud": 115200}, identity={}, words="low-first"),
        True,
        lambda d: outputs(d, "pressure", "dump", "e_stop", 250.0),
    ),
    "festo-cpx-e": (FestoCpxE, terminal, False, lambda d: outputs(d, "ao4.0", "do2.0", "di1.0", 8000.0)),
    "labjack": (LabJack, t7, False, lambda d: outputs(d, "DAC0", "FIO0", "FIO1", 1.5, 1.0)),
    "serial-line-daq": (SerialLineDaq, board, True, lambda d: outputs(d, "o0", "v0", "d0", 250.0)),
    "serial-ascii": (SerialIndicator, cell, True, sampled),
    "alicat-ascii": (AlicatController, controller, True, regulated),
    "alicat-modbus": (AlicatController, lambda path: controller(path, "modbus"), True, regulated),
    "festo-cmmt": (FestoCmmt, drive, False, lambda d: moved(d, "position", 5000.0, "")),
    "can": (
        CanBus,
        lambda address="127.0.0.1:0": bus(f"slcan:socket://{address}"),
        False,
        lambda d: moved(d, "drive.position", 5000.0, "drive.ready"),
    ),
    "ni-daqmx": (NiDaq, lambda address="127.0.0.1:0": daq_of_tasks(server=address), False, tasked),
    "dataq": (Dataq, daq, True, streamed(500.0)),
    "ild1420": (Ild1420, laser, True, streamed(1000.0)),
}
"""Name -> the driver, its device, whether it has a serial port, and what is done."""
BY_HAND = ("festo-cmmt", "can", "ni-daqmx")
"""Their driver has a thread that talks all the time: here its turns are made by the script."""


def device_of(name, path):
    """The device of a script, at the port `path` where it has a serial one."""
    _driver, record, serial, _use = SCRIPTS[name]
    return record(path) if serial else record()


def reached(record, address):
    """The device at an address: of itself, or of the server that it is asked through."""
    if "server" in record.options:
        return replace(record, options={**record.options, "server": address})
    return replace(record, address=address)


def use(name, record):
    """Open the driver, do what the script says, close it; who answered, and what the script gave."""
    driver, _record, _serial, script = SCRIPTS[name]
    device = driver(record, RealClock())
    random.seed(1)
    by_hand = patch.object(Cycle, "start", lambda *_: None) if name in BY_HAND else nullcontext()
    same = patch("socket.gethostname", return_value="bench"), patch.object(Connection, "left", lambda _: 0.125)
    with by_hand, same[0], same[1]:  # NI's messages hold the computer's name and the time that is left
        try:
            identity = device.open()
            return replace(identity), list(script(device))
        finally:
            device.close()
