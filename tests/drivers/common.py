"""What tests of all drivers need: a device open in front of its emulator, waiting for something, timing a call."""

import contextlib
import time
from dataclasses import replace
from importlib import import_module

import pytest
from pmabench_drivers.emulator import Emulator

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError


def driver_of(record):
    """The driver of a device, not open."""
    module, _, name = record.driver.partition(":")
    return getattr(import_module(module), name)(record, RealClock())


@contextlib.contextmanager
def opened(record):
    """The driver of a device, open."""
    driver = driver_of(record)
    try:
        driver.open()
        yield driver
    finally:
        driver.close()


def at_address(record, address):
    """The record with the address that its emulator really has; a path stays."""
    return record if record.address.startswith("/") else replace(record, address=address)


@contextlib.contextmanager
def in_front(record, *, opened=True, at=at_address, preset="ideal", **options):
    """A device's emulator, what it serves, and the driver in front of it; `at`: the record with the served address."""
    emulator = Emulator([record], preset=preset, **options)
    driver = None
    try:
        served = emulator.devices[record.name]
        driver = driver_of(at(record, served.address))
        if opened:
            driver.open()
        yield emulator, served, driver
    finally:
        if driver is not None:
            driver.close()
        emulator.close()


def refused(record, prepare):
    """Why a driver is not opened, within 2 s, in front of an emulated device that `prepare` has changed."""
    emulator = Emulator([record])
    try:
        prepare(emulator.devices[record.name])
        start = time.monotonic()
        with pytest.raises(DeviceError) as caught:
            driver_of(record).open()
        assert time.monotonic() - start < 2.0
        return str(caught.value)
    finally:
        emulator.close()


def until(condition, within=3.0):
    """Whether it comes true within a time [s]."""
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.01)
    return False


def timed(call, *arguments, **keywords):
    """How long a call takes [s], and what it gave or raised."""
    start = time.monotonic()
    try:
        outcome = call(*arguments, **keywords)
    except Exception as error:
        outcome = error
    return time.monotonic() - start, outcome
