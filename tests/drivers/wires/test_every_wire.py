"""Every fault of a link on every emulator's own wire: a question is sent by hand, and what comes is looked at."""

import contextlib
import os
import select
import socket
import time

import pytest
from pmabench_drivers.emulator import Emulator
from pmabench_drivers.emulator.faults import LINK

from tests.captures.capture import read
from tests.captures.scripts import SCRIPTS, device_of

pytestmark = pytest.mark.realtime

QUIET, LONG = 0.05, 3.0
"""How long nothing comes where nothing should, and how long an answer may take on a busy machine [s]."""


class Raw:
    """The other end of a wire, without a driver."""

    def __init__(self, address):
        self._socket = None
        if address.startswith("/"):
            self._file = os.open(address, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        else:
            host, _, port = address.rpartition(":")
            self._socket = socket.create_connection((host, int(port)), timeout=5)
            self._socket.setblocking(False)
            self._file = self._socket.fileno()

    def close(self):
        if self._socket is not None:
            self._socket.close()
        else:
            os.close(self._file)

    def ask(self, question, size):
        """What comes: until there are `size` bytes and no more, or the wire has ended (then None)."""
        os.write(self._file, question)
        found, end = b"", time.monotonic() + (LONG if size else QUIET)
        while (left := end - time.monotonic()) > 0:
            if not select.select([self._file], [], [], left)[0]:
                break
            try:
                data = os.read(self._file, 4096)
            except OSError:
                return None
            if not data:
                return None
            found += data
            if len(found) >= size:
                end = min(end, time.monotonic() + 0.02)
        return found


SHARED = {"can", "ni-daqmx"}
"""A bus and a server: a connection of its own has to be made before anything is answered; their own tests do that."""


@pytest.fixture(params=[name for name in SCRIPTS if name not in SHARED])
def wire(request, tmp_path):
    """A device's faults, a question of its driver, its answer, and who asks anew."""
    device = device_of(request.param, tmp_path / "port")
    emulator = Emulator([device], preset="ideal")
    emulator.plant.quantities = lambda: {"pressure": 123456.0, "displacement": 0.0123, "force": 58.86}
    served = emulator.devices[device.name]
    question = read(request.param).runs[0].data
    ends = []

    def ask(size, again=True):
        if again or not ends:
            ends.append(Raw(served.address))
        return ends[-1].ask(question, size)

    try:
        answer = ask(1)
        assert answer
        yield served.faults, ask, answer
    finally:
        for end in ends:
            with contextlib.suppress(OSError):
                end.close()
        emulator.close()


def test_what_each_fault_does(wire):
    faults, ask, answer = wire
    whole = len(answer)
    seen = {}

    def meet(kind, value, size, times=1):
        faults.set(kind, value)
        found = [ask(size if index == 0 else whole, again=index == 0) for index in range(times)]
        faults.set("clear")
        seen[kind] = found[-1]
        return found[-1] if times == 1 else found

    assert not meet("silence", None, 0)
    assert not meet("lost", 1.0, 0)
    began = time.monotonic()
    assert meet("delay", 0.06, whole) == answer
    assert time.monotonic() - began >= 0.06
    assert ask(whole) == answer
    assert meet("truncated", 1, whole - 1) == answer[:-1]
    assert meet("corrupted", 0, whole) == bytes([answer[0] ^ 0xFF]) + answer[1:]
    garbage = meet("garbage", None, whole + 1)
    assert len(garbage) > whole
    assert garbage.endswith(answer)
    assert meet("double", None, 2 * whole) == 2 * answer
    assert ask(whole) == answer
    assert meet("stale", None, 0) in {answer, b""}  # the same question has the same answer before
    late = meet("late", None, 0, times=2)
    assert late == [b"", answer] or late[0] is None  # a terminal hangs up where it hears nothing for 0.1 s
    assert {*seen} == {*LINK} - {"hang-up", "reset"}


@pytest.mark.parametrize("kind", ["hang-up", "reset"])
def test_the_wire_ends(wire, kind):
    faults, ask, answer = wire
    faults.set(kind)
    if kind == "reset" and "skew" in faults.kinds and "watchdog" in faults.kinds and "exception" not in faults.kinds:
        assert ask(0) == b""  # a board that starts again keeps its line
        assert ask(len(answer)) == answer
    else:
        assert ask(1) is None
