"""festo-cpx-io in front of a CPX-E with 16DI, 8DO, 4AI-UI and 4AO-UI: calls of its CPX-E examples and modules.

Calls: the examples example_cpxe_*.py of https://github.com/Festo-se/festo-cpx-io, and what each module class offers.
Only the port is changed in the client, which knows 502 alone. Channel 0 of the outputs is the regulator, 32000 counts
for 1 MPa, channels 0 and 1 of the inputs its pressure and a gauge of 10 um a count; channel 0 of the 8DO the dump valve.
"""

import functools
import logging
import sys
import time

from cpx_io.cpx_system import cpx_base
from cpx_io.cpx_system.cpx_e.cpx_e import CpxE
from cpx_io.cpx_system.cpx_e.e4aiui import CpxE4AiUI
from cpx_io.cpx_system.cpx_e.e4aoui import CpxE4AoUI
from cpx_io.cpx_system.cpx_e.e8do import CpxE8Do
from cpx_io.cpx_system.cpx_e.e16di import CpxE16Di
from cpx_io.cpx_system.cpx_e.eep import CpxEEp
from said import call, not_tried

HOST, PORT = sys.argv[1].rsplit(":", 1)
TYPECODE = "60E-EP-MLNINO"
LONG = 2.0
"""Time-out of the terminal [s]: a busy machine must not end the connection."""
PASCAL, METRE = 1e6 / 32_000, 1e-5


logging.disable(logging.CRITICAL)
cpx_base.ModbusTcpClient = functools.partial(cpx_base.ModbusTcpClient, port=int(PORT))

with call("CpxE(timeout=...), connected, shutdown"):
    with CpxE(ip_address=HOST, timeout=LONG) as cpx:
        assert cpx.connected()
        assert int.from_bytes(cpx.read_reg_data(46100), "little") == 2000
    assert not cpx.connected()

with call("CpxE(modules=[...]), names"), CpxE(ip_address=HOST, modules=[CpxEEp(), CpxE16Di()]) as cpx:
    cpx.modules[0].name = "ep_module"
    assert cpx.cpxe16di is cpx.modules[1]
    assert len(cpx.cpxe16di.read_channels()) == 16

with call("add_module"), CpxE(ip_address=HOST) as cpx:
    for module in (CpxE16Di(), CpxE8Do(), CpxE4AiUI(), CpxE4AoUI()):
        cpx.add_module(module)
    assert [module.position for module in cpx.modules] == [0, 1, 2, 3, 4]
    assert cpx.cpxe4aiui.read_status() == [False] * 16

cpx = CpxE(TYPECODE, ip_address=HOST, timeout=LONG)

with call("CpxE(typecode)"):
    assert [type(m).__name__ for m in cpx.modules] == ["CpxEEp", "CpxE16Di", "CpxE8Do", "CpxE4AiUI", "CpxE4AoUI"]
    assert cpx.modules[3].system_entry_registers.inputs == 45399

with call("module_count"):
    assert cpx.module_count() == 5

with call("read_device_info"):
    info = cpx.read_device_info()
    assert info["vendor_name"]
    assert info["product_name"]

with call("read_device_identification"):
    assert isinstance(cpx.read_device_identification(), int)

with call("read_status, read_fault_detection"):
    assert cpx.read_status() == (False, False)
    assert cpx.read_fault_detection() == [False] * 24

with call("read_function_number: ranges"):
    assert cpx.read_function_number(4828 + 64 * 3 + 13) == 0x21
    assert cpx.read_function_number(4828 + 64 * 4 + 11) & 0x0F == 1

with call("set_timeout"):
    cpx.set_timeout(50)  # the client makes 100 of it, the least that the terminal takes
    assert int.from_bytes(cpx.read_reg_data(46100), "little") == 100
    cpx.set_timeout(int(1e3 * LONG))

with call("CpxE16Di: read_channels, read_channel, read_status"):
    channels = cpx.cpxe16di.read_channels()
    assert channels[0], "the emergency stop, which is not pressed, is low"
    assert channels[1:] == [False] * 15
    assert cpx.cpxe16di[0] == cpx.cpxe16di.read_channel(0) == channels[0]
    assert not any(cpx.cpxe16di.read_status())

with call("CpxE8Do: write_channels, read_channels, read_channel"):
    wanted = [False, True, False, False, True, False, False, True]
    cpx.cpxe8do.write_channels(wanted)
    time.sleep(0.02)
    assert cpx.cpxe8do.read_channels() == wanted
    assert cpx.cpxe8do.read_channel(4)
    cpx.cpxe8do.write_channels([False] * 8)

with call("CpxE8Do: set_channel, reset_channel, toggle_channel") as saw:
    for change, on in (("set", True), ("reset", False), ("toggle", True)):
        getattr(cpx.cpxe8do, f"{change}_channel")(0)
        time.sleep(0.02)
        assert cpx.cpxe8do[0] is on
    saw["valve"] = 1.0

with call("CpxE4AoUI: write_channel, read_channel, read_channels, read_status") as saw:
    cpx.cpxe4aoui.write_channel(0, 9_600)
    cpx.cpxe4aoui[1] = -1_000
    time.sleep(0.02)
    assert cpx.cpxe4aoui.read_channels() == [9_600, -1_000, 0, 0]
    assert cpx.cpxe4aoui[0] == 9_600
    assert not any(cpx.cpxe4aoui.read_status())
    saw["commanded"] = 9_600 * PASCAL

with call("CpxE4AiUI: read_channels, read_channel, read_status") as saw:
    time.sleep(1.0)
    pressure, displacement, *rest = cpx.cpxe4aiui.read_channels()
    assert rest == [0, 0]
    assert abs(cpx.cpxe4aiui[0] - pressure) < 100
    assert not any(cpx.cpxe4aiui.read_status())
    saw.update(pressure=pressure * PASCAL, displacement=displacement * METRE)

with call("CpxE4AoUI: write_channels") as saw:
    cpx.cpxe4aoui.write_channels([3_200, 0, 0, 0])
    time.sleep(1.0)
    saw.update(commanded=3_200 * PASCAL, pressure=cpx.cpxe4aiui.read_channel(0) * PASCAL)

with call("the time-out ends, check_connection_and_try_reconnect, reconnect") as saw:
    cpx.set_timeout(100)
    time.sleep(0.4)
    try:
        cpx.module_count()
    except ConnectionAbortedError:
        cpx.reconnect()
    else:
        raise AssertionError("the terminal keeps a connection after its time-out")
    cpx.check_connection_and_try_reconnect()
    cpx.set_timeout(int(1e3 * LONG))
    assert cpx.cpxe4aoui.read_channels() == [0, 0, 0, 0], "the outputs stay after the time-out"
    saw["commanded"] = 0.0

not_tried("CpxE4Iol, CpxE1Ci", "neither IO-Link modules nor counters are emulated")
not_tried("configure_*", "the driver writes no parameter")
not_tried("CpxAp", "no CPX-AP is emulated")
cpx.shutdown()
