"""The clients, a line each: README.md says how one is added."""

from collections.abc import Callable
from dataclasses import dataclass

from tests.drivers.alicat.rigs import controller
from tests.drivers.can.rigs import bus
from tests.drivers.festo.rigs import terminal
from tests.drivers.festo_cmmt.rigs import drive
from tests.drivers.labjack.rigs import t7
from tests.drivers.ni.rigs import daq
from tests.drivers.wires.rigs import regulator


def _address(served):
    return [served.address]


@dataclass(frozen=True)
class Client:
    """A client that others wrote, in front of one emulated device."""

    name: str
    what: str
    """Client and device, as docs/clients.md names them."""
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
    Client("alicat", "alicat 0.9.0 / PCD", "alicat==0.9.0", "alicat_client.py", lambda line: controller(line, baud=19200)),
    Client("labjack", "Modbus TCP by hand / T7", "", "labjack_raw.py", lambda _line: t7()),
    Client("nidaqmx", "nidaqmx 1.7.0 over gRPC / USB-6215", "", "nidaqmx_client.py", lambda _line: daq()),
    Client("minimalmodbus", "minimalmodbus 2.1.1 / register map on RTU", "minimalmodbus==2.1.1", "minimalmodbus_client.py", lambda line: regulator(str(line))),
    Client("pymodbus", "pymodbus / register map on TCP", "", "pymodbus_client.py", lambda _line: regulator()),
    Client("mbpoll", "mbpoll / register map on TCP", "", "mbpoll_client.py", lambda _line: regulator(), program="mbpoll"),
    Client("canopen", "canopen / CiA 402 drive and CiA 406 encoder", "", "canopen_nodes.py", lambda _line: bus()),
    Client("festo-cpx-io", "festo-cpx-io / CPX-E", "festo-cpx-io==0.11.3", "festo_cpx_io.py", lambda _line: terminal()),
    Client("festo-edcon", "festo-edcon / CMMT", "festo-edcon==1.0.3", "festo_edcon.py", lambda _line: drive()),
)  # fmt: skip
