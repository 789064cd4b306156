"""The clients, a line each: README.md says how one is added."""

from collections.abc import Callable
from dataclasses import dataclass

from tests.drivers.can.rigs import bus
from tests.drivers.festo.rigs import terminal
from tests.drivers.festo_cmmt.rigs import drive
from tests.drivers.labjack.rigs import t7


def _address(served):
    return [served.address]


@dataclass(frozen=True)
class Client:
    """A client that others wrote, in front of one emulated device."""

    name: str
    what: str
    """Client and device, as docs/devices.md names them."""
    package: str
    """What `pip install` is given for an environment of its own; empty: the project's own environment has the client."""
    script: str
    device: Callable
    """Makes the record of the device from a path for a serial line."""
    addresses: Callable = _address
    """What of the served device the script is given."""
    program: str = ""
    """A program of the system that the script needs; a machine without it does not run it."""


CLIENTS: tuple[Client, ...] = (
    Client("labjack", "Modbus TCP by hand / T7", "", "labjack_raw.py", lambda _line: t7()),
    Client("canopen", "canopen / CiA 402 drive and CiA 406 encoder", "", "canopen_nodes.py", lambda _line: bus()),
    Client("festo-cpx-io", "festo-cpx-io / CPX-E", "festo-cpx-io==0.11.3", "festo_cpx_io.py", lambda _line: terminal()),
    Client("festo-edcon", "festo-edcon / CMMT", "festo-edcon==1.0.3", "festo_edcon.py", lambda _line: drive()),
)  # fmt: skip
