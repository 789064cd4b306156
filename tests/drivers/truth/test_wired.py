"""What an emulator takes from the truth file and what from the bench file; no wire."""

from dataclasses import replace

import pytest
from pmabench_drivers.emulator import wired

from pmabench.base.errors import UsageError
from pmabench.bench.interface import Scale
from pmabench.bench.truth import read_truth
from pmabench.files.shipped import find_file
from tests.drivers.truth.raw import CLIENTS
from tests.drivers.truth.rigs import records


@pytest.mark.parametrize("name", CLIENTS)
def test_of_the_bench_only_names_and_places_are_used(tmp_path, name):
    """Every scale, sign, terminal and valve of the bench file is wrong, and its options are gone: the rig is the same."""
    truth = read_truth(find_file("truth", name))
    right = records(tmp_path, name)
    wrong = [
        replace(
            device,
            driver="pmabench_drivers.mock:MockBench",
            options={key: value for key, value in device.options.items() if key in {"server", "stream_port"}},
            channels=tuple(replace(c, scale=Scale(-3.0 * c.scale.slope, 7.0), input="x") for c in device.channels),
            outputs=tuple(replace(o, scale=Scale(5.0 * o.scale.slope, 1.0), output="y") for o in device.outputs),
            valves=tuple(replace(valve, energised="open") for valve in device.valves),
            interlocks=(),
        )
        for device in right
    ]
    found = wired(wrong, truth)
    assert found == wired(right, truth)
    assert [item.address for item in found] == [device.address for device in right]


def test_a_device_that_the_truth_does_not_know_is_refused(tmp_path):
    [device] = records(tmp_path, "labjack")
    with pytest.raises(UsageError, match='says nothing of the device "t8"'):
        wired([replace(device, name="t8")], read_truth(find_file("truth", "labjack")))
