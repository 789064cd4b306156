"""Drivers with one fault each, made of the example driver: the suite must find every one of them.

The name of a class in `FAULTS` leads to the check that must fail.
"""

import sys
import threading
import time
from array import array
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "docs" / "driver-example"))  # also in a process of its own

from pmabench_driver_example import ExampleController
from pmabench_driver_example.wire import Connection

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block


class SendsTwice(ExampleController):
    """A write is repeated to be sure."""

    def write(self, output, value):
        super().write(output, value)
        super().write(output, value)


class RetriesInSilence(ExampleController):
    """A write that is not answered is sent again."""

    def write(self, output, value):
        self._timeout_of_connection(0.05)
        try:
            super().write(output, value)
        except DeviceError:
            super().write(output, value)

    def _timeout_of_connection(self, seconds):
        self._opened()._timeout = seconds


class ForgetsToRefuse(ExampleController):
    """Closed, it fails with an error of Python."""

    def _opened(self):
        if self._connection is None:
            raise AttributeError("'NoneType' object has no attribute 'ask'")
        return self._connection


class Waits(ExampleController):
    """Its time-out is longer than a call may take."""

    def open(self):
        identity = super().open()
        self._connection._timeout = 1.0
        return identity

    def _ask(self, text):
        return self._opened().ask(text, time.monotonic() + 1.0)


class StartsEarly(ExampleController):
    """It has a thread before it is opened."""

    def __init__(self, device, clock):
        super().__init__(device, clock)
        threading.Thread(target=time.sleep, args=(1.0,), daemon=True).start()


class LoadsEarly(ExampleController):
    """It loads a heavy library when it is built."""

    def __init__(self, device, clock):
        import numpy  # noqa: F401

        super().__init__(device, clock)


class TakesAnyOption(ExampleController):
    """It finds nothing wrong with any option."""

    @classmethod
    def check(cls, device):
        return []


class _Trusting(Connection):
    """Keeps the connection after a time-out, and does not look at the number of an answer."""

    def ask(self, text, deadline):
        with self._lock:
            connection = self._connected(deadline)
            connection.sendall(b"00 %s*%02X\n" % (text.encode(), sum(b"00 " + text.encode()) % 256))
            connection.settimeout(max(0.001, min(deadline - time.monotonic(), self._timeout)))
            try:
                return connection.recv(200).split(b"\n")[0][3:].split(b"*")[0].decode("ascii", "replace")
            except OSError as error:
                raise DeviceError(self._device, f"no answer: {error}") from None


class TakesOldAnswers(ExampleController):
    """The answer to an older question is taken for the newest."""

    def open(self):
        identity = super().open()
        self._connection.close()
        self._connection = _Trusting(self._device.name, self._device.address, self._timeout)
        return identity


class LeavesALine(ExampleController):
    """After close() its connection is still there."""

    kept = []

    def close(self):
        if self._connection is not None and self._connection._socket is not None:
            self.kept.append(self._connection._socket.dup())
        super().close()


class LeavesAThread(ExampleController):
    """After close() its thread still polls."""

    def open(self):
        threading.Thread(target=time.sleep, args=(30.0,), name="left behind", daemon=True).start()
        return super().open()


class MakesUpSamples(ExampleController):
    """When the device is silent it repeats the last value."""

    def collect(self):
        now = round(self._clock.now() * 1e9)
        return Block(array("q", [now]), {"pressure": array("d", [0.0])}, now)


class GoesBackInTime(ExampleController):
    """Its samples are not in order."""

    def collect(self):
        block = super().collect()
        return Block(list(block.time)[::-1], block.columns, block.host)


class SaysTheWrongThing(ExampleController):
    """A valve is told the wrong way round."""

    def is_on(self, output):
        return not super().is_on(output)


class ForgetsAWrite(ExampleController):
    """The second of three commands never leaves."""

    count = 0

    def write(self, output, value):
        self.count += 1
        if self.count % 2:
            super().write(output, value)


class _Plain(Connection):
    """Believes that every answer is whole text."""

    def ask(self, text, deadline):
        try:
            return super().ask(text, deadline)
        except DeviceError as error:
            if "damaged" in str(error) or "invalid" in str(error):
                raise ValueError(str(error)) from None
            raise


class Chokes(ExampleController):
    """Bytes of no meaning end in an error of Python."""

    def open(self):
        self.close()
        identity = super().open()
        self._connection.close()
        self._connection = _Plain(self._device.name, self._device.address, self._timeout)
        return identity


class OtherBytes(ExampleController):
    """It sends another format than the manual says."""

    def write(self, output, value):
        self._ask(f"S {value:.3f}")


class IsHardware(ExampleController):
    """It has no emulator, and its device does not say that it is emulated."""

    emulator = ""

    def open(self):
        from dataclasses import replace

        from pmabench.bench.interface import Identity

        return replace(Identity("Example", "EX-1", "1", "1.0"), simulated=False)


FAULTS = {
    "SendsTwice": "set-points",
    "RetriesInSilence": "silence",
    "ForgetsToRefuse": "life",
    "Waits": "silence",
    "StartsEarly": "interface",
    "LoadsEarly": "imports",
    "TakesAnyOption": "options",
    "TakesOldAnswers": "late answers",
    "LeavesALine": "nothing left",
    "LeavesAThread": "nothing left",
    "MakesUpSamples": "silence",
    "GoesBackInTime": "samples",
    "SaysTheWrongThing": "valves",
    "ForgetsAWrite": "set-points",
    "Chokes": "hostile answers",
    "OtherBytes": "exchanges",
    "IsHardware": "life",
}
