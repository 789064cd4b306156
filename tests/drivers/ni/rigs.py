"""A USB-6215 as a record, emulated behind NI's gRPC server and opened; and calls by the package `nidaqmx` itself."""

import contextlib
import time
from dataclasses import replace
from unittest.mock import patch

import grpc
import nidaqmx

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import ChannelRecord, DeviceRecord, InterlockRecord, OutputRecord, Scale, ValveRecord
from tests.drivers.common import in_front

DRIVER = "pmabench_drivers.ni_daq:NiDaq"
CHANNELS = (
    ("pressure", "pressure", Scale(1e5, -50e3)),
    ("displacement", "length", Scale(0.01, -0.005)),
    ("force", "force", Scale(200.0, -50.0)),
    ("pressure_command", "pressure", Scale(1e5)),
)
STEP = 20 / 2**16
"""Step of a 16-bit output over -10 V to 10 V [V]."""


def channel(name, quantity, number, scale):
    return ChannelRecord(name, quantity, "daq", f"ai{number}", "float64", "V", scale, -1e9, 1e9)


def daq(channels=4, server="127.0.0.1:0", address="Dev1", watchdog=0.0, **options):
    """A USB-6215 with the rig's channels (and more, up to `channels`), a regulator, a dump valve, an emergency stop."""
    known = [channel(name, quantity, i, scale) for i, (name, quantity, scale) in enumerate(CHANNELS)]
    more = [channel(f"spare{i}", "pressure", i, Scale()) for i in range(len(known), channels)]
    given = {**({"server": server} if server else {}), **options}
    return DeviceRecord(
        "daq",
        DRIVER,
        address,
        given,
        tuple([*known, *more][:channels]),
        (OutputRecord("pressure", "pressure", "daq", "ao0", Scale(1e5), 0.000306, 0.0, 0.0, 6e5),),
        (ValveRecord("dump_valve", "daq", "port1/line0"),),
        (InterlockRecord("e-stop", "daq", "port0/line0"),),
        watchdog,
    )


def at(record, server):
    """The record with another server."""
    return replace(record, options={**record.options, "server": server})


SLACK = {"CALL": 2.0, "ANSWER": 1.0, "STEP": 0.5, "OPEN": 10.0}
"""Deadlines of the driver where a test is not about them: for a machine that has much else to do [s]."""


@contextlib.contextmanager
def rig(record=None, *, opened=True, slack=True):
    """An emulated server and the driver in front of it: emulator, emulated server, driver."""
    record = record or daq()
    with contextlib.ExitStack() as stack:
        if slack:
            stack.enter_context(patch.multiple("pmabench_drivers.ni_daq", **SLACK))
            stack.enter_context(patch("pmabench_drivers.ni_daq.FETCH", 0.6))
        yield stack.enter_context(in_front(record, opened=opened, at=at))


def start(device, rate):
    """Start to sample; again where a busy machine did not answer in time."""
    return patiently(lambda: device.start(rate))


def patiently(call, within=10.0):
    """What a call gives; again where no answer came in time, which a busy machine may do."""
    until = time.monotonic() + within
    while True:
        try:
            return call()
        except DeviceError as error:
            if time.monotonic() > until or not any(word in str(error) for word in ("did not answer", "no sample for")):
                raise
        time.sleep(0.02)


@contextlib.contextmanager
def task(served, name):
    """A task as any program makes one with NI's package, without this project's driver."""
    with grpc.insecure_channel(served.address) as wire:
        options = nidaqmx.GrpcSessionOptions(wire, name)
        with nidaqmx.Task(name, grpc_options=options) as made:
            yield made
