"""The package `alicat` 0.9.0 in front of an MCD on a serial line, whose loop controls gauge pressure.

Calls: the README of the package, https://github.com/alexrudd2/alicat (Usage, Gas Type, PID Parameters, Other Features), in an order in which
the pressure can be compared; then the other methods of `FlowController`, and questions of Alicat's Serial Primer by the
client's own line.
"""

import asyncio
import os
import sys

from alicat import FlowController, FlowMeter
from said import call, not_tried

PORT = os.path.realpath(sys.argv[1])
"""The client takes a path under /dev for a serial line, and anything else for a TCP address."""
AIR = 101.325
"""Of the open air [kPa]."""


def near(found, wanted, within):
    assert abs(found - wanted) <= within, f"{found} instead of {wanted}"


async def usage(device):
    with call("FlowController, get") as saw:
        state = await device.get()
        names = {"pressure", "temperature", "volumetric_flow", "mass_flow", "setpoint", "gas", "control_point"}
        assert set(state) == names, sorted(state)
        assert state["control_point"] == "gauge pressure"
        assert state["gas"] == "Air"
        near(state["setpoint"], 0.0, 0.01)
        saw["pressure"] = 1e3 * state["pressure"]
    with call("FlowController.set_pressure(20): gauge pressure") as saw:
        await device.set_pressure(20)
        await asyncio.sleep(2.0)
        state = await device.get()
        near(state["setpoint"], 20.0, 0.01)
        saw["pressure"], saw["commanded"] = 1e3 * state["pressure"], 20e3
    with call("FlowController.set_flow_rate(1.0)") as saw:
        await device.set_flow_rate(1.0)
        await asyncio.sleep(2.0)
        state = await device.get()
        assert state["control_point"] == "mass flow"
        near(state["setpoint"], 1.0, 0.01)
        near(state["mass_flow"], 1.0, 0.01)
        assert state["pressure"] > 20.0
        await device.set_flow_rate(0.0)
        await asyncio.sleep(1.0)
        saw["pressure"] = 1e3 * (await device.get())["pressure"]
    with call("FlowController.set_pressure(150): absolute pressure after a flow") as saw:
        await device.set_pressure(150)
        await asyncio.sleep(2.0)
        state = await device.get()
        assert state["control_point"] == "abs pressure"
        near(state["setpoint"], 150.0, 0.01)
        saw["pressure"], saw["commanded"] = 1e3 * (state["pressure"] - AIR), 1e3 * (150 - AIR)


async def gases(device):
    with call("FlowController.set_gas('N2')"):
        await device.set_gas("N2")
        assert (await device.get())["gas"] == "N2"
    with call("FlowController.set_gas(8)"):
        await device.set_gas(8)
        assert (await device.get())["gas"] == "N2"
    with call("FlowController.create_mix"):
        await device.create_mix(mix_no=236, name="Mix1", gases={"N2": 50, "O2": 30, "CO2": 20})
    with call("FlowController.set_gas(236)"):
        await device.set_gas(236)
        assert (await device.get())["gas"].upper() == "MIX1"
    with call("FlowController.delete_mix"):
        await device.set_gas("Air")
        await device.delete_mix(236)
        try:
            await device.delete_mix(236)
        except OSError:
            return
        raise AssertionError("a mix that is not there was deleted")


async def features(device):
    with call("FlowController.set_pid, get_pid"):
        await device.set_pid(p=4000, i=4000, d=10, loop_type="PD2I")
        assert await device.get_pid() == {"loop_type": "PD2I", "P": "4000", "I": "4000", "D": "10"}
    with call("FlowController.lock, is_locked, unlock"):
        await device.lock()
        assert await device.is_locked()
        await device.unlock()
        assert not await device.is_locked()
    with call("FlowController.hold, cancel_hold") as saw:
        await device.hold()
        line = await device._write_and_read("A")
        assert line.split()[-1] == "HLD"
        await device.cancel_hold()
        saw["pressure"] = 1e3 * ((await device.get())["pressure"] - AIR)
    with call("FlowController.tare_volumetric"):
        await device.tare_volumetric()
    with call("FlowController.tare_pressure"):
        await device.tare_pressure()
    with call("FlowController.reset_totalizer"):
        await device.reset_totalizer()
    not_tried("FlowController.get_totalizer_batch, set_totalizer_batch", "the emulated device has no totalizer")
    with call("FlowController.get_firmware"):
        assert "10v20" in await device.get_firmware()
    with call("FlowController.set_ramp_config, get_ramp_config"):
        wanted = {"up": True, "down": False, "zero": True, "power": False}
        await device.set_ramp_config(wanted)
        assert await device.get_ramp_config() == wanted
    with call("FlowController.set_maxramp, get_maxramp") as saw:
        await device.set_maxramp(10, "s")
        found = await device.get_maxramp()
        near(found["max_ramp"], 10.0, 1e-6)
        assert found["units"].endswith("/s")
        await device.set_pressure(180)
        await asyncio.sleep(1.5)
        near((await device.get())["setpoint"], 165.0, 4.0)
        await asyncio.sleep(3.5)
        near((await device.get())["setpoint"], 180.0, 0.01)
        await device.set_maxramp(0, "s")
        saw["pressure"] = 1e3 * ((await device.get())["pressure"] - AIR)
    with call("FlowController._set_control_point('gauge pressure')"):
        await device._set_control_point("gauge pressure")
        assert (await device.get())["control_point"] == "gauge pressure"


async def primer(device):
    """Questions of the primer that the client has no method for."""
    for command, wanted in (
        ("LV", "A 38"),
        ("DCU 6", "A 4 kPaG"),
        ("FPF 6", "A +1000.00 4 kPaG"),
        ("FPF 5", "A +100.00 7 SLPM"),
        ("LSS", "A S"),
    ):
        found = await device._write_and_read(f"A{command}")
        assert found == wanted, f"A{command}: {found!r} instead of {wanted!r}"
    found = await device._write_and_read("ALS 30")
    assert found == "A +0030.00 +0030.00 4 kPaG", found
    await asyncio.sleep(2.0)
    near(float(await device._write_and_read("ADV 10 6")), 30.0, 1.0)


async def main():
    device = FlowController(PORT, "A")
    await usage(device)
    await gases(device)
    await features(device)
    with call("LV, DCU, FPF, LSS, LS, DV of the primer, firmware 10v20") as saw:
        await primer(device)
        saw["commanded"] = 30e3
    with call("two objects on one port"):
        other = FlowMeter(PORT, "A")
        assert await other.get_firmware() == await device.get_firmware()
        await other.close()
        near((await device.get())["setpoint"], 30.0, 0.01)
    with call("FlowController.close"):
        await device._set_setpoint(0)
        await device.close()
    with call("FlowController.is_connected"):
        assert await FlowController.is_connected(PORT, "A")


asyncio.run(main())
