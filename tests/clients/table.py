"""The clients, a line each: README.md says how one is added."""

from collections.abc import Callable
from dataclasses import dataclass

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
)  # fmt: skip
