"""Our CAN code next to python-can's slcan, canopen and cantools: what docs/decisions/0022 says. Run by hand:

python -m tests.benchmarks.can_libraries
"""

import contextlib
import os
import statistics
import subprocess
import sys
import threading
import time
import tty

import can
import canopen
import cantools
from pmabench_drivers.canbus import frames as f
from pmabench_drivers.canbus.link import Link, PythonCan, Slcan, open_adapter
from pmabench_drivers.canbus.node import Objects
from pmabench_drivers.canbus.options import read_dbc

from pmabench.base.clock import RealClock
from tests.drivers.can.rigs import rig

FRAMES, RATE, BURST = 6000, 2000, 20
"""Frames that are sent over the pseudo-terminal, how many a second, and how many at once."""
ASKED = 500
DBC = 'BO_ 500 Cell: 8 X\n SG_ Force : 7|16@0- (0.1,0) [0|0] "N" X\n SG_ Temp : 16|12@1+ (0.5,-40) [0|0] "C" X\n'


def shown(name, times):
    """Median, 99th percentile and worst of times [ms]."""
    ordered = sorted(1e3 * t for t in times)
    print(f"{name:44} {statistics.median(ordered):8.3f} {ordered[int(0.99 * len(ordered))]:8.3f} {ordered[-1]:8.3f} ms")


def imports():
    """Processor time and modules of an interpreter that loads what a guard would load."""
    for what in ("pmabench_drivers.canbus", "can", "canopen", "cantools", "can, canopen, cantools"):
        code = f"import sys, time; n = len(sys.modules); t = time.process_time(); import {what}; "
        code += "print(time.process_time() - t, len(sys.modules) - n)"
        runs = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout for _ in range(5)]
        best = min(float(run.split()[0]) for run in runs)
        print(f"import {what:37} {1e3 * best:8.0f} ms of processor time, {runs[0].split()[1]} modules")


def received(make, damage=b""):
    """Frames that come of those that a process sends over a pseudo-terminal, and the processor time of receiving."""
    near, far = os.openpty()
    tty.setraw(far)
    os.set_blocking(near, False)
    name = os.ttyname(far)
    adapter = make(name)

    def send():
        due = time.monotonic()
        for first in range(0, FRAMES, BURST):
            lines = b"".join(b"t1238%016X\r" % number for number in range(first, first + BURST))
            with contextlib.suppress(BlockingIOError):  # nobody listens any more
                os.write(near, lines + (damage if first == FRAMES // 2 else b""))
            due += BURST / RATE
            time.sleep(max(0.0, due - time.monotonic()))

    sender = threading.Thread(target=send)
    began, count, heard, errors = time.process_time(), 0, time.monotonic(), 0
    sender.start()
    while time.monotonic() - heard < 0.7:
        try:
            frame = adapter.receive(0.05)
        except OSError:
            errors += 1
            if errors > 20:
                break
            continue
        if frame is not None:
            count, heard = count + 1, time.monotonic()
    spent = time.process_time() - began
    sender.join()
    adapter.close()
    for end in (near, far):
        os.close(end)
    return count, errors, spent


def own(name):
    return Slcan(name, 500_000)


def foreign(name):
    adapter = PythonCan.__new__(PythonCan)
    adapter._can, adapter.serial = can, ""
    adapter._bus = can.Bus(interface="slcan", channel=name, bitrate=500_000, sleep_after_open=0.3)
    return adapter


def slcan():
    """Lost frames, damaged lines, processor time."""
    for damage, what in ((b"", "clean"), (b"t1\xff38\r", "a byte that is no ASCII"), (b"t1zz8AA\r", "no number")):
        for name, make in (("ours", own), ("python-can", foreign)):
            count, errors, spent = received(make, damage)
            lost = FRAMES - count
            print(
                f"slcan, {what:24} {name:12} {lost:6} of {FRAMES} lost, {errors} errors, {1e6 * spent / FRAMES:.0f} us a frame"
            )


def questions():
    """SDO round trips and the time that it takes to hand over a PDO, to the same emulated drive."""
    with rig(opened=False) as (_emulator, served, _driver):
        address = served.address
        takers = {}
        link = Link(
            "bus",
            address,
            lambda: open_adapter(address, 500_000, ask=False),
            RealClock(),
            lambda frame, _when: takers[frame.identifier](frame.data) if frame.identifier in takers else None,
        )
        objects = Objects("bus", "drive", 5, link.send)
        takers[f.SDO_ANSWER + 5] = objects.take
        times = []
        for _ in range(ASKED):
            began = time.monotonic()
            objects.read(0x6041, 0, "H", began + 0.15)
            times.append(time.monotonic() - began)
        shown("SDO, ours", times)
        times = []
        for number in range(ASKED):
            began = time.monotonic()
            link.send(0x205, number.to_bytes(4, "little"))
            times.append(time.monotonic() - began)
            time.sleep(0.001)
        shown("PDO handed over, ours", times)
        link.close()
        network = canopen.Network()
        network.connect(interface="slcan", channel=address.removeprefix("slcan:"), bitrate=500_000, sleep_after_open=0)
        node = network.add_node(canopen.RemoteNode(5, canopen.ObjectDictionary()))
        times = []
        for _ in range(ASKED):
            began = time.monotonic()
            node.sdo.upload(0x6041, 0)
            times.append(time.monotonic() - began)
        shown("SDO, canopen", times)
        times = []
        for number in range(ASKED):
            began = time.monotonic()
            network.send_message(0x205, number.to_bytes(4, "little"))
            times.append(time.monotonic() - began)
            time.sleep(0.001)
        shown("PDO handed over, canopen", times)
        served.faults.set("silence")
        began = time.monotonic()
        try:
            node.sdo.upload(0x6041, 0)
        except canopen.SdoCommunicationError:
            print(f"SDO without an answer, canopen as it comes: {time.monotonic() - began:.2f} s")
        served.faults.set("clear")
        network.disconnect()


def database():
    """Time to read a DBC file, and to decode a frame."""
    messages, theirs = read_dbc(DBC), cantools.database.load_string(DBC, "dbc")
    data, many = bytes(range(8)), 20_000
    large = "".join(DBC.replace("500 Cell", f"{i} M{i}") for i in range(1, 1500))
    for name, read in (("ours", read_dbc), ("cantools", lambda text: cantools.database.load_string(text, "dbc"))):
        began = time.process_time()
        read(large)
        print(f"DBC of {len(large) // 1000} kB, {name:12} {time.process_time() - began:.2f} s of processor time")
    began = time.process_time()
    for _ in range(many):
        _ = [signal.value(data) for signal in messages["Cell"].signals.values()]
    ours, began = time.process_time() - began, time.process_time()
    for _ in range(many):
        theirs.decode_message(500, data)
    spent = time.process_time() - began
    print(f"decoding two signals: ours {1e6 * ours / many:.1f} us, cantools {1e6 * spent / many:.1f} us")


if __name__ == "__main__":
    print(f"load {os.getloadavg()[0]:.1f}, {os.cpu_count()} processors; median, 99 %, worst")
    imports()
    slcan()
    questions()
    database()
