"""A CPX-E as a record, open in front of its emulator, and what is done to single requests."""

import contextlib

from pmabench.bench.interface import ChannelRecord, DeviceRecord, InterlockRecord, OutputRecord, Scale, ValveRecord
from tests.drivers.common import in_front

DRIVER = "pmabench_drivers.festo_cpx_e:FestoCpxE"
KPA = Scale(1e6 / 32000)
OPTIONS = {
    "modules": ["16di", "8do", "4ai-ui", "4ao-ui"],
    "ranges": {"ai3.0": "0..10 V", "ai3.1": "-10..10 V", "ao4.0": "0..10 V"},
    "rate": "200 Hz",
}


def terminal(address="127.0.0.1:0", **changes):
    """A regulator at ao4.0, its pressure at ai3.0, displacement at ai3.1, dump valve at do2.0, e-stop at di1.0."""
    return DeviceRecord(
        "terminal",
        DRIVER,
        address,
        {**OPTIONS, **changes},
        (
            ChannelRecord("pressure", "pressure", "terminal", "ai3.0", "int32", "count", KPA, -20e3, 1e6),
            ChannelRecord("displacement", "length", "terminal", "ai3.1", "int32", "count", Scale(1e-5), -0.005, 0.09),
        ),
        (OutputRecord("pressure", "pressure", "terminal", "ao4.0", KPA, 1.0, 0.0, 0.0, 6e5),),
        (ValveRecord("dump_valve", "terminal", "do2.0"),),
        (InterlockRecord("e-stop", "terminal", "di1.0"),),
        0.5,
    )


class Rig:
    """Emulator and driver of one terminal."""

    def __init__(self, emulator, server, device):
        self.emulator, self.server, self.device = emulator, server, device
        self.inside = server.registers

    def log(self, kind):
        return self.emulator.log.of(kind, "terminal")

    def at_requests(self, functions, kind, value=None):
        """Let the fault meet only requests with these function codes."""
        plain = type(self.server).answer

        def answer(pdu, connection):
            self.server.faults.set(kind if pdu[0] in functions else "clear", value)
            return plain(self.server, pdu, connection)

        self.server.answer = answer

    def well(self):
        """No faults any more."""
        with contextlib.suppress(AttributeError):
            del self.server.answer
        self.server.faults.set("clear")


@contextlib.contextmanager
def served(record=None, **options):
    """A rig whose driver is not open."""
    with in_front(record or terminal(), opened=False, **options) as parts:
        yield Rig(*parts)
