"""Each shipped rig shows its plant by the data sheets: to a client of the test's own, and to the project's drivers."""

import time

import pytest

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Watchdog
from tests.drivers.truth.raw import CLIENTS
from tests.drivers.truth.rigs import driver, pressurised, read, rig, stretched

pytestmark = pytest.mark.realtime
CLOSE = {"pressure": 200.0, "displacement": 3e-5, "force": 0.6}
"""What the coarsest device resolves [SI]."""


@pytest.mark.parametrize("name", CLIENTS)
def test_a_client_that_knows_only_data_sheets_and_the_shipped_bench_read_what_is_true_of_the_plant(tmp_path, name):
    client, _device, quantity = CLIENTS[name]
    with rig(tmp_path, name) as (emulator, records):
        true = pressurised(emulator)
        assert emulator.proven
        at = {device: served.address for device, served in emulator.devices.items()}
        assert true[quantity] > 50 * CLOSE[quantity]
        assert client(at) == pytest.approx(true[quantity], abs=CLOSE[quantity])
        for record in records.values():
            for what, value in read(record).items() if record.channels else ():
                quantity = {"supply": "pressure"}.get(what, what.removesuffix("_command"))
                if what not in {"pressure_command", "displacement_command"}:
                    assert value == pytest.approx(true[what], abs=2 * CLOSE[quantity]), (record.name, what)


@pytest.mark.parametrize("name", CLIENTS)
def test_a_bench_whose_slope_is_twice_the_right_one_reads_twice_as_much(tmp_path, name):
    device, quantity = {"festo-sine": ("terminal", "pressure")}.get(name, CLIENTS[name][1:])
    with rig(tmp_path, name, stretched(quantity, 2.0)) as (emulator, records):
        true, [channel] = pressurised(emulator), [c for c in records[device].channels if c.name == quantity]
        expected = 2.0 * true[quantity] - channel.scale.offset
        assert read(records[device])[quantity] == pytest.approx(expected, abs=4 * CLOSE[quantity])


def test_a_drive_that_knows_its_unit_is_not_opened_with_another_one(tmp_path):
    why = r"counts in 1e-6 m, and the bench file in 2e-06 m"
    with (
        rig(tmp_path, "festo-sine", stretched("displacement", 2.0)) as (_emulator, records),
        pytest.raises(DeviceError, match=why),
    ):
        read(records["drive"])


SETTERS = {
    "festo": "terminal",
    "labjack": "t7",
    "labjack-t8": "t8",
    "ni": "daq",
    "serial-line-daq": "board",
    "wires": "regulator",
}
"""Shipped bench -> the device with its regulator."""


@pytest.mark.parametrize("name", SETTERS)
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_what_is_commanded_is_done_by_the_data_sheet_whatever_the_bench_believes(tmp_path, name, factor):
    with rig(tmp_path, name, stretched("output.pressure", factor)) as (emulator, records):
        record = records[SETTERS[name]]
        [output] = record.outputs
        with driver(record) as device:
            if isinstance(device, Watchdog):
                device.arm_watchdog(record.watchdog)
            device.write(output.output, round(float(output.scale.to_raw(3e5)), 3))
            time.sleep(0.05)  # the plant is sampled every millisecond
            done = emulator.plant.quantities()["pressure_command"]
            if isinstance(device, Watchdog):
                device.disarm_watchdog()
    assert done == pytest.approx(3e5 / factor, abs=500.0)
