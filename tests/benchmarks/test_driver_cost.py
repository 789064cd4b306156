"""What a poll through our Modbus driver costs beside the library alone, over the same socket to the same emulator.

The library alone: one read of two registers, made a float. Ours: the same as a sample with its times. In turn, many short
batches of each; the tenth of each that the rest of the machine disturbed least is compared, and printed (`make bench`).
"""

import contextlib
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pmabench_drivers.modbus import ModbusDevice

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from tests.drivers.wires.rigs import regulator

ROOT = Path(__file__).resolve().parents[2]
SERVER = """
import sys
from pmabench_drivers.emulator import Emulator
from tests.drivers.wires.rigs import regulator
emulator = Emulator([regulator()], preset="ideal")
emulator.plant.quantities = lambda: {"pressure": 123456.0}
print(emulator.devices["regulator"].address, flush=True)
sys.stdin.read()
"""
BATCH, BATCHES, FEW = 40, 400, 20
RATIO = 0.9


@pytest.mark.realtime
@pytest.mark.alone
def test_a_poll_costs_little_more_than_the_library(benchmark):
    from pymodbus.client import ModbusTcpClient

    batches = FEW if benchmark.disabled else BATCHES
    server = subprocess.Popen(
        [sys.executable, "-c", SERVER],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT, env={"PYTHONPATH": f"{ROOT}:{ROOT}/drivers"},
    )  # fmt: skip
    try:
        address = server.stdout.readline().strip()
        host, _, port = address.rpartition(":")
        client = ModbusTcpClient(host, port=int(port), timeout=1.0, retries=0)
        client.connect()
        device = ModbusDevice(regulator(address), RealClock())
        device.open()
        device._streaming = True  # as while its thread asks

        def alone():
            answer = client.read_input_registers(0, count=2, device_id=7)
            return client.convert_from_registers(answer.registers, client.DATATYPE.FLOAT32)

        def per_call(call):
            began = time.perf_counter()
            for _ in range(BATCH):
                call()
            return 1e6 * (time.perf_counter() - began) / BATCH

        assert alone() == pytest.approx(123.456)
        device._poll()
        assert list(device.collect().columns["pressure"]) == [pytest.approx(123.456)]
        library, ours = [], []
        while len(ours) < batches:
            with contextlib.suppress(DeviceError):  # the machine stood still for 0.1 s
                pair = per_call(alone), per_call(device._poll)
                library.append(pair[0])
                ours.append(pair[1])
            device.collect()
        client.close()
        device.close()
    finally:
        server.communicate(timeout=10)
    benchmark.pedantic(lambda: None, rounds=1)
    best = [statistics.quantiles(times, n=10)[0] for times in (library, ours)]
    ratio = best[0] / best[1]
    print(
        f"\nModbus TCP: the library alone {best[0]:.1f} us, a poll of our driver {best[1]:.1f} us a round trip: ratio "
        f"{ratio:.2f}, at least {RATIO}"
    )
    benchmark.extra_info.update(ratio=ratio, library=best[0], ours=best[1])
    assert benchmark.disabled or ratio > RATIO
