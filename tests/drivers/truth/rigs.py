"""Shipped rigs built from their truth files, in a known state; their drivers by the records of a bench."""

import time
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module

from pmabench_drivers.emulator import Emulator

from pmabench.base.clock import RealClock
from pmabench.bench.compile import mount_alone
from pmabench.bench.interface import Scale
from pmabench.bench.truth import read_truth
from pmabench.files.shipped import find_file
from tests.drivers.emulated_bench import own_bench

STATE = {"force": 60.0, "mass": 8.0}
"""What hangs on the free end [N], [kg]."""


def records(tmp_path, name):
    """The devices of a shipped bench, on ports of their own."""
    return mount_alone(own_bench(tmp_path, name)).bench.devices


@contextmanager
def rig(tmp_path, name, change=lambda device: device, **options):
    """The emulator from the truth file, and the records of a bench file that `change` may have made wrong."""
    devices = [change(device) for device in records(tmp_path, name)]
    emulator = Emulator(devices, truth=read_truth(find_file("truth", name)), preset="ideal", **options)
    try:
        yield emulator, {device.name: device for device in devices}
    finally:
        emulator.close()


def pressurised(emulator, pressure=2e5):
    """The plant at rest under pressure, loaded or driven; what is true of it [SI]."""
    plant = emulator.plant
    plant.switch(on=True)
    plant.command(pressure)
    if "displacement_command" in plant.quantities():
        plant.drive(0.02)
    else:
        plant.load(STATE["force"], STATE["mass"])
    before, end = {}, time.monotonic() + 15
    while time.monotonic() < end:
        now = plant.quantities()
        if before and all(abs(now[key] - before[key]) < 1e-5 * max(1.0, abs(now[key])) for key in now):
            return now
        before = now
        time.sleep(0.3)
    raise AssertionError(f"the plant does not come to rest: {before}")


@contextmanager
def driver(record):
    """The driver of a record, open."""
    module, _, name = record.driver.partition(":")
    device = getattr(import_module(module), name)(record, RealClock())
    device.open()
    try:
        yield device
    finally:
        device.close()


def read(record, rate=50.0):
    """The last sample of every channel as the bench understands it [SI]."""
    with driver(record) as device:
        device.start(rate)
        end, columns = time.monotonic() + 3.0, {}
        while time.monotonic() < end:
            time.sleep(0.1)
            block = device.collect()
            if len(block.time):
                columns = {name: float(values[-1]) for name, values in block.columns.items()}
                break
        device.stop()
    return {c.name: float(c.scale.to_si(columns[c.name])) for c in record.channels}


def stretched(what, factor):
    """What makes the slope of one channel, or of "output.NAME", of a bench file so many times the right one."""

    def bent(item):
        name = f"output.{item.name}" if hasattr(item, "output") else item.name
        return replace(item, scale=Scale(factor * item.scale.slope, item.scale.offset)) if name == what else item

    def change(device):
        return replace(
            device,
            channels=tuple(bent(channel) for channel in device.channels),
            outputs=tuple(bent(output) for output in device.outputs),
        )

    return change
