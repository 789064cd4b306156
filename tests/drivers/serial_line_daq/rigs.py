"""Boards on pseudo-terminals: the emulator, the sketch's protocol code compiled for this computer, and one by hand."""

import contextlib
import os
import select
import shutil
import subprocess
import threading
import time
import tty
from functools import lru_cache
from pathlib import Path

import pmabench_drivers.serial_line_daq as package
import pytest
from pmabench_drivers.emulator.faults import CommandLog
from pmabench_drivers.emulator.plant import RealPlant
from pmabench_drivers.serial_line_daq import encode
from pmabench_drivers.serial_line_daq.emulator import EmulatedBoard

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import ChannelRecord, DeviceRecord, InterlockRecord, OutputRecord, Scale, ValveRecord

SKETCH = Path(package.__file__).parent / "sketch"
HOST = Path(__file__).parent / "board.cpp"
LATE = 0.4
"""A call ends within 0.2 s, and so late on a machine that has much else to do [s]."""
DRIVER = "pmabench_drivers.serial_line_daq:SerialLineDaq"


def board(address, **changes):
    """A rig on one board: pressure in counts of 1 kPa from -50 kPa, regulator in steps of 1 kPa, dump valve, e-stop."""
    columns = {
        "pressure": ("a0", "pressure", 1e3),
        "displacement": ("a1", "length", 1e-5),
        "force": ("a2", "force", 1.0),
    }
    given = {
        "channels": tuple(
            ChannelRecord(name, quantity, "board", pin, "int32", "count", Scale(slope, -50 * slope), -1e9, 1e9)
            for name, (pin, quantity, slope) in columns.items()
        ),
        "outputs": (OutputRecord("pressure", "pressure", "board", "o0", Scale(1e3), 1.0, 0.0, 0.0, 6e5),),
        "valves": (ValveRecord("dump_valve", "board", "v0"),),
        "interlocks": (InterlockRecord("e-stop", "board", "d0"),),
        "watchdog": 0.5,
    }
    return DeviceRecord("board", DRIVER, str(address), **{**given, **changes})


@lru_cache(maxsize=1)
def compiled(folder):
    """The sketch's protocol code as a program, checked while it runs for every access outside of its memory."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("not run: no C++ compiler")
    program = Path(folder) / "board"
    flags = [
        "-std=c++11",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-O1",
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover",
    ]
    subprocess.run([compiler, *flags, f"-I{SKETCH}", str(HOST), "-o", str(program)], check=True)
    return program


@contextlib.contextmanager
def sketch(program, boot_micros=0, stall=0):
    """The compiled sketch under way, and the address of its port."""
    near, far = os.openpty()
    tty.setraw(far)
    process = subprocess.Popen(
        [program, str(near), str(boot_micros), str(stall)], pass_fds=[near], stderr=subprocess.PIPE
    )
    os.close(near)
    try:
        yield os.ttyname(far)
        assert process.poll() is None, process.stderr.read().decode()
    finally:
        process.kill()
        process.communicate()
        os.close(far)


@contextlib.contextmanager
def emulated(path, boot_micros=0):
    """An emulated board with its plant."""
    log = CommandLog()
    served = EmulatedBoard(board(path), RealPlant(preset="ideal"), log, boot_micros)
    served.plant, served.log = served._plant, log
    served.start()
    try:
        yield served
    finally:
        served.close()


IDENTITY = ("line-daq", 1, "emulated by hand", "1", 3, 1, 1, 1, 4095, 2000)


class Hand:
    """A board whose answers are written by hand: `reply(letter, number, values)` gives the bytes to be sent."""

    def __init__(self, reply=None):
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        self.address, self.reply, self.heard = os.ttyname(self._far), reply, []
        self._ended = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._ended = True
        self._thread.join(2)
        os.close(self._near)
        os.close(self._far)

    def send(self, data):
        """Send bytes, as long as anybody takes them."""
        if select.select([], [self._near], [], 0)[1]:
            os.write(self._near, data)

    def _serve(self):
        waiting = b""
        while not self._ended:
            if not select.select([self._near], [], [], 0.05)[0]:
                continue
            *lines, waiting = (waiting + os.read(self._near, 4096)).split(b"\n")
            for line in lines:
                letter, number, *values = line.split(b"*")[0].decode().split(",")
                self.heard.append((letter, *map(int, values)))
                own = self.reply(letter, number, [int(value) for value in values]) if self.reply else None
                self.send(proper(letter, number, values) if own is None else own)


def proper(letter, number, values):
    """What a board answers that holds all it is told."""
    if letter == "I":
        return encode("A", number, *IDENTITY)
    return encode("A", number, int(values[-1]) if values else 1)


def gather(driver, seconds):
    """Times [ns] and columns that come within a time."""
    times, columns = [], {}
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        time.sleep(0.02)
        block = driver.collect()
        times += block.time
        for name, column in block.columns.items():
            columns.setdefault(name, []).extend(column)
    return times, columns


def collected(driver, count, within=5.0):
    """The same, as soon as `count` samples have come; silence before and after them does not matter."""
    times, columns = [], {}
    until = time.monotonic() + within
    while len(times) < count:
        assert time.monotonic() < until, f"{len(times)} samples of {count}"
        with contextlib.suppress(DeviceError):
            block = driver.collect()
            times += block.time
            for name, column in block.columns.items():
                columns.setdefault(name, []).extend(column)
        time.sleep(0.01)
    return times, columns
