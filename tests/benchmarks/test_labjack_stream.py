"""The stream of a LabJack at 10 kHz and four channels, sustained, from an emulator in a process of its own. Printed, -s."""

import time
from dataclasses import replace

import numpy as np
import pytest
from pmabench_drivers.labjack import LabJack

from pmabench.base.clock import RealClock
from pmabench.bench.compile import mount
from pmabench.files.shipped import shipped_folder
from tests.drivers.emulated_bench import emulate, own_bench

RATE = 10_000.0
SECONDS, SHORT = 20.0, 1.0
"""How long it streams [s], and how long where nothing is measured."""

pytestmark = [pytest.mark.realtime, pytest.mark.alone]


def streamed(device, seconds):
    """Times of all scans [ns], rate, scans lost, share of a processor that receiving takes."""
    used = device.start(RATE)
    times = []
    began, spent = time.monotonic(), time.process_time()
    while time.monotonic() < began + seconds:
        time.sleep(0.02)
        block = device.collect()
        times.append(np.asarray(block.time, dtype=np.int64))
        assert {len(column) for column in block.columns.values()} == {len(block.time)}
    share = (time.process_time() - spent) / (time.monotonic() - began)
    lost = device.lost
    device.stop()
    return np.concatenate(times), used, lost, share


def test_10_khz_of_four_channels(benchmark, tmp_path):
    path = own_bench(tmp_path, "labjack")
    [record] = mount(path, shipped_folder("specimen") / "mas-20-250-paper0.yaml").bench.devices
    with emulate(path) as (_process, said):
        device = LabJack(replace(record, address=said["devices"]["t7"]), RealClock())
        device.open()
        try:
            seconds = SHORT if benchmark.disabled else SECONDS
            times, used, lost, share = benchmark.pedantic(streamed, args=(device, seconds), rounds=1)
        finally:
            device.close()
    rate = (len(times) - 1) / (times[-1] - times[0]) * 1e9
    print(f"{len(times)} scans of 4 channels at {rate:.1f} Hz, {lost} lost, receiving takes {share:.0%} of a processor")
    benchmark.extra_info.update(rate=rate, lost=lost, share=share)
    assert used == pytest.approx(RATE, rel=1e-4)
    assert lost == 0
    assert set(np.diff(times)) == {100_000}  # each scan once, none left out
    assert len(times) > 0.8 * seconds * RATE
