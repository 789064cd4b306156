"""Faults in the example driver's own bytes."""

import time
from dataclasses import replace

from pmabench_driver_example.wire import Connection

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block, Identity
from tests.conformance.faults import fault


class _Wire:
    """Another connection under the example driver."""

    kind = None

    def _connect(self):
        return self.kind(self._device.name, self._device.address, self._options.timeout)


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


@fault("example", "late answers", "older question")
class TakesOldAnswers(_Wire):
    """The answer to an older question is taken for the newest."""

    kind = _Trusting


class _Plain(Connection):
    """Believes that every answer is whole text."""

    def ask(self, text, deadline):
        try:
            return super().ask(text, deadline)
        except DeviceError as error:
            if "damaged" in str(error) or "invalid" in str(error):
                raise ValueError(str(error)) from None
            raise


@fault("example", "hostile answers", "ValueError")
class Chokes(_Wire):
    """Bytes of no meaning end in an error of Python."""

    kind = _Plain


class _Patient(Connection):
    """Its time-out is longer than a call may take."""

    def ask(self, text, deadline):
        self._timeout = 1.0
        return super().ask(text, time.monotonic() + 1.0)


@fault("example", "silence", "took")
class Waits(_Wire):
    """No time-out that is short enough."""

    kind = _Patient


class _Eager(Connection):
    """Sends again what was not answered."""

    def ask(self, text, deadline):
        self._timeout = 0.04
        try:
            return super().ask(text, deadline)
        except DeviceError:
            return super().ask(text, deadline)


@fault("example", "silence", "2 times")
class RetriesInSilence(_Wire):
    """A write that is not answered is sent again."""

    kind = _Eager


class _Forever(Connection):
    """Without any time-out."""

    def ask(self, text, deadline):
        self._timeout = 60.0
        return super().ask(text, time.monotonic() + 60.0)


@fault("example", "silence", "")
class WaitsForEver(_Wire):
    kind = _Forever


@fault("example", "values", "where the emulated plant has")
class ReadsTheOtherInput:
    """The order of the page's answer is mixed up."""

    def __init__(self, device, clock):
        super().__init__(device, clock)
        self._places = self._places[::-1]


@fault("example", "life", "has no emulator")
class IsHardware:
    """It has no emulator, and its device does not say that it is emulated."""

    emulator = ""

    def open(self):
        return Identity("Example", "EX-2", "1", "1.0", simulated=False)


@fault("example", "life", "simulated=False")
class ForgetsThatItIsEmulated:
    """What is recorded would be taken for a real muscle."""

    def open(self):
        return replace(super().open(), simulated=False)


@fault("example", "samples", "missing")
class KeepsTenSamplesOnly:
    """What is not collected in time is lost."""

    def collect(self):
        block = super().collect()
        return Block(block.time[-10:], {name: column[-10:] for name, column in block.columns.items()}, block.host)
