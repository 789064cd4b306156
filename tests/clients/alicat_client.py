"""The package `alicat` 0.9.0 in front of a PCD on a serial line.

Its methods are those of a flow controller, https://github.com/alexrudd2/alicat. Here: those that a pressure controller
has as well, and by the client's own line the questions of Alicat's Serial Primer that the driver asks.
"""

import asyncio
import os
import sys

from alicat import FlowMeter
from said import call, not_tried

PORT = os.path.realpath(sys.argv[1])
"""The client takes a path under /dev for a serial line, and anything else for a TCP address."""


def near(found, wanted, within):
    assert abs(found - wanted) <= within, f"{found} instead of {wanted}"


async def line(device, command=""):
    """Pressure, set-point and status of the data line that answers a command."""
    unit, pressure, set_point, *status = (await device._write_and_read(f"A{command}")).split()
    assert unit == "A"
    return float(pressure), float(set_point), status


async def main():
    device = FlowMeter(PORT, "A")
    with call("poll") as saw:
        pressure, set_point, status = await line(device)
        near(set_point, 0.0, 0.01)
        assert status == []
        saw["pressure"] = 1e3 * pressure
    with call("S20.00, poll") as saw:
        near((await line(device, "S20.00"))[1], 20.0, 0.01)
        await asyncio.sleep(2.0)
        pressure, set_point, _ = await line(device)
        near(set_point, 20.0, 0.01)
        saw["pressure"], saw["commanded"] = 1e3 * pressure, 20e3
    with call("H, C: valves held, and no more"):
        assert (await line(device, "H"))[2] == ["HLD"]
        assert (await line(device, "C"))[2] == []
    with call("DCU, LSS of the primer, firmware 10v20"):
        for command, wanted in (("DCU 38", "A 4 kPaG"), ("LSS", "A S"), ("LSS S", "A S")):
            found = await device._write_and_read(f"A{command}")
            assert found == wanted, f"A{command}: {found!r} instead of {wanted!r}"
    with call("FlowMeter.get_firmware"):
        assert "10v20" in await device.get_firmware()
    with call("two objects on one port"):
        other = FlowMeter(PORT, "A")
        assert await other.get_firmware() == await device.get_firmware()
        await other.close()
        near((await line(device))[1], 20.0, 0.01)
    with call("FlowMeter.close") as saw:
        near((await line(device, "S0.00"))[1], 0.0, 0.01)
        await device.close()
        saw["commanded"] = 0.0
    not_tried(
        "FlowController.get, set_pressure, ...", "it asks for register 122, or expects the columns of a flow controller"
    )


asyncio.run(main())
