"""A mock device for tests: its record, and a rig that collects what it samples in virtual time."""

import numpy as np
from pmabench_drivers.mock import MockBench

from pmabench.base.clock import VirtualClock
from pmabench.bench.interface import ChannelRecord, DeviceRecord, InterlockRecord, OutputRecord, Scale, ValveRecord

COUNTS = {
    "pressure": ("pressure", Scale(1e6 / 65535, -50e3), -50e3, 950e3),
    "displacement": ("length", Scale(0.5e-6, -5e-3), -5e-3, 90e-3),
    "force": ("force", Scale(2000 / 65535, -50.0), -50.0, 1950.0),
}
RANGES = {
    "pressure": ("pressure", 1e6),
    "displacement": ("length", 0.1),
    "force": ("force", 2e3),
    "supply": ("pressure", 1e6),
    "pressure_set": ("pressure", 1e6),
    "displacement_set": ("length", 0.1),
}


def record(counts=False, actuator=False, valve=False, driver="pmabench_drivers.mock:MockBench", **options):
    """A device of the mock with every channel in SI or counts; set-points in counts, 65535 for 1000 kPa."""
    inputs = ["pressure", "displacement", "force", "supply", "pressure_set"] + ["displacement_set"] * actuator
    channels = []
    for name in inputs:
        if counts and name in COUNTS:
            quantity, scale, low, high = COUNTS[name]
            channels.append(ChannelRecord(name, quantity, "plant", name, "int32", "count", scale, low, high))
        else:
            quantity, high = RANGES[name]
            channels.append(ChannelRecord(name, quantity, "plant", name, "float64", "SI", Scale(), -high, high))
    outputs = [OutputRecord("pressure", "pressure", "plant", "pressure", Scale(1e6 / 65535), 1, 0, 0, 6e5)]
    if actuator:
        options["free_end"] = "actuator"
        outputs.append(OutputRecord("displacement", "length", "plant", "displacement", Scale(1e-3), 0, 0, 0, 0.05))
    given = {"preset": "ideal", **options}
    valves = (ValveRecord("dump valve", "plant", "dump_valve"),) if valve else ()
    interlocks = (InterlockRecord("e-stop", "plant", "e_stop"),) if valve else ()
    return DeviceRecord("plant", driver, "", given, tuple(channels), tuple(outputs), valves, interlocks)


class Rig:
    """An open mock with its clock; collects SI or raw columns."""

    def __init__(self, device, rate=500.0):
        self.clock, self.device = VirtualClock(), device
        self.mock = MockBench(device, self.clock)
        self.mock.open()
        self.mock.start(rate)
        self.time, self.columns = [], {channel.name: [] for channel in device.channels}

    def pressure(self, kPa):
        self.mock.write("pressure", kPa * 65.535)

    def wait(self, duration, block=1.0):
        end = self.clock.now() + duration
        while self.clock.now() < end - 1e-12:
            self.clock.wait_until(min(self.clock.now() + block, end))
            self.collect()

    def collect(self):
        block = self.mock.collect()
        self.time.extend(int(t) for t in block.time)
        for name, column in self.columns.items():
            column.extend(float(value) for value in block.columns[name])

    def back_to(self, moment):
        """What the executor does: time goes back, the device is told by a call, samples after it are dropped."""
        self.clock.back_to(moment)
        assert len(self.mock.collect().time) == 0
        kept = sum(t <= round(moment * 1e9) for t in self.time)
        del self.time[kept:]
        for column in self.columns.values():
            del column[kept:]

    def array(self, name):
        return np.array(self.columns[name])
