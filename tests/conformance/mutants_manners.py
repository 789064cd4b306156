"""Faults of watchdog, supervision, second way and manners."""

import socket
import threading
import time
from array import array

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Block, Identity
from tests.conformance.faults import fault

# -- watchdog, and what is held ---------------------------------------------------------------------------------------


@fault("Watchdog", "watchdog", "")
class ArmsAnotherTime:
    """Twice what it says."""

    def arm_watchdog(self, seconds):
        super().arm_watchdog(2 * seconds)
        return seconds


@fault("Watchdog", "watchdog", "did nothing")
class ArmsNothing:
    def arm_watchdog(self, seconds):
        return seconds

    def feed_watchdog(self):
        pass


@fault("Watchdog", "watchdog", "")
class FeedsNothing:
    def feed_watchdog(self):
        pass


@fault("Watchdog", "watchdog", "")
class DisarmsNothing:
    def disarm_watchdog(self):
        pass


@fault("Watchdog", "watchdog", "arm_watchdog")
class ArmReturnsNothing:
    def arm_watchdog(self, seconds):
        super().arm_watchdog(seconds)


@fault("Watchdog", "watchdog", "")
class FedByAThread:
    """It feeds by itself, even where the program hangs."""

    def arm_watchdog(self, seconds):
        held = super().arm_watchdog(seconds)
        self.fed_no_more = threading.Event()  # a name that no driver has
        threading.Thread(target=self._go_on, daemon=True).start()
        return held

    def _go_on(self):
        try:
            while not self.fed_no_more.wait(0.1):
                super().feed_watchdog()
        except DeviceError:
            pass

    def disarm_watchdog(self):
        self.fed_no_more.set()
        super().disarm_watchdog()


@fault("Supervised", "held", "")
class HeldFromMemory:
    first = None

    def held(self):
        super().held()
        self.first = self.first or dict(super().held())
        return self.first


@fault("Watchdog", "held", "watchdog")
class HeldRemembersTheWatchdog:
    """What was armed is shown, not what the device says."""

    armed = 0.0

    def arm_watchdog(self, seconds):
        self.armed = super().arm_watchdog(seconds)
        return self.armed

    def disarm_watchdog(self):
        super().disarm_watchdog()
        self.armed = 0.0

    def held(self):
        return {**super().held(), "watchdog": self.armed}


@fault("Watchdog", "held", "watchdog")
class HeldWithoutAWatchdog:
    def held(self):
        return {name: value for name, value in super().held().items() if name != "watchdog"}


@fault("Supervised", "held", "nothing happened")
class HeldChangesByItself:
    n = 0

    def held(self):
        self.n += 1
        return {**super().held(), "pressure": float(self.n)}


@fault("Supervised", "held", "memory")
class HeldSwallowsErrors:
    last = None

    def held(self):
        try:
            self.last = dict(super().held())
        except DeviceError:
            if self.last is None:
                raise
        return self.last


@fault("Rescue", "second way", "after rescue()")
class RescueDoesNothing:
    def rescue(self, output, value):
        pass


@fault("Rescue", "second way", "after rescue()", least=2)
class RescueOfTheFirstOutputOnly:
    """Valves are left as they are."""

    def rescue(self, output, value):
        if output == self._device.outputs[0].output:
            super().rescue(output, value)


@fault("Rescue", "second way", "took")
class RescueWaits:
    def rescue(self, output, value):
        time.sleep(0.7)
        super().rescue(output, value)


# -- manners ----------------------------------------------------------------------------------------------------------


@fault("", "imports", "numpy")
class LoadsEarly:
    def __init__(self, device, clock):
        import numpy  # noqa: F401

        super().__init__(device, clock)


@fault("", "interface", "thread")
class StartsEarly:
    def __init__(self, device, clock):
        super().__init__(device, clock)
        threading.Thread(target=time.sleep, args=(1.0,), daemon=True).start()


@fault("", "options", "check() takes")
class TakesAnyOption:
    @classmethod
    def check(cls, device):
        return []


@fault("", "nothing left", "threads")
class LeavesAThread:
    def open(self):
        threading.Thread(target=time.sleep, args=(30.0,), name="left behind", daemon=True).start()
        return super().open()


@fault("", "nothing left", "more open files")
class LeavesASocket:
    kept = []

    def close(self):
        super().close()
        self.kept.append(socket.socket())


@fault("SetPoint", "nothing left", "rounds of")
class LeaksWithEachCall:
    kept = []

    def read_back(self, output):
        self.kept.append(socket.socket())
        return super().read_back(output)

    def close(self):
        super().close()
        while self.kept:
            self.kept.pop().close()


@fault("SetPoint", "set-points", "took")
class ReadsBackSlowly:
    def read_back(self, output):
        time.sleep(0.6)
        return super().read_back(output)


@fault("SetPoint", "life", "commands something")
class CommandsAtOpen:
    """The set-point is put to its safe value."""

    def open(self):
        identity = super().open()
        record = self._device.outputs[0]
        super().write(record.output, float(record.scale.to_raw(record.safe)))
        return identity


@fault("", "life", "")
class ClosesOnce:
    """A second `close` is an error of Python."""

    closed = True

    def open(self):
        self.closed = True
        identity = super().open()
        self.closed = False
        return identity

    def close(self):
        if self.closed and hasattr(self, "_was"):
            raise AttributeError("'NoneType' object has no attribute 'close'")
        self._was = self.closed = True
        super().close()


@fault("", "life", "")
class OpenReturnsNothing:
    def open(self):
        super().open()


# -- of any driver, on a bad wire -------------------------------------------------------------------------------------


@fault("SetPoint", "set-points", "2 times")
class WritesTwice:
    """To be sure."""

    def write(self, output, value):
        super().write(output, value)
        super().write(output, value)


@fault("Stream", "silence", "made up")
class MakesUpSamples:
    """When the device is silent it repeats the last values."""

    last = None

    def collect(self):
        try:
            block = super().collect()
        except DeviceError:
            block = Block([], {name: [] for name in (self.last or {})})
        if len(block.time):
            self.last = {name: column[-1] for name, column in block.columns.items()}
            return block
        now = round(self._clock.now() * 1e9)
        return Block(array("q", [now]), {name: [value] for name, value in (self.last or {}).items()}, now)


@fault("", "nobody there", "")
class OpensAnyhow:
    """Where nobody answers it opens all the same."""

    def open(self):
        try:
            return super().open()
        except DeviceError:
            return Identity("Example", "EX-2", "1", "1", simulated=True)


@fault("", "life", "after close()")
class ForgetsToRefuse:
    """Closed, it fails with an error of Python."""

    def close(self):
        super().close()
        self.read_back = self.is_on = self.level = self.collect = self._none

    def _none(self, *_name):
        raise AttributeError("'NoneType' object has no attribute 'ask'")
