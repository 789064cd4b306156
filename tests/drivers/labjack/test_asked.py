"""A T8 and a T4, which are asked for each sample, in front of the emulator."""

import time
from dataclasses import replace
from itertools import pairwise

import pytest
from pmabench_drivers.labjack import LabJack
from pmabench_drivers.labjack import registers as r
from pymodbus.client import ModbusTcpClient

from pmabench.base.errors import DeviceError
from pmabench.bench.interface import Scale, Segment
from tests.drivers.common import timed, until
from tests.drivers.labjack.rigs import CHANNELS, rig, t7

FULL = {"T4": 5.0, "T8": 10.0}
STEP = {"T4": 5.0 / 1024, "T8": 10.0 / 65536}


def asked(model, channels=4, **options):
    """A rig's device without stream, its regulator over the whole voltage of the DAC."""
    record = t7(channels, model=model, rate="100 Hz", **options)
    given = {key: value for key, value in record.options.items() if key != "stream_port"}
    output = replace(record.outputs[0], scale=Scale(1e6 / FULL[model]), resolution=STEP[model])
    return replace(record, options=given, outputs=(output,))


def problems(record):
    return {".".join(map(str, place)): text for place, text in LabJack.check(record)}


@pytest.mark.parametrize("model", ["T4", "T8"])
def test_a_model_without_stream_has_options_of_its_own(model):
    record = asked(model)
    assert problems(record) == {}
    assert LabJack.fastest(record) == 100.0
    assert (
        "has no stream_port"
        in problems(replace(record, options={"model": model, "stream_port": 702}))["options.stream_port"]
    )
    assert "at the rate of the protocol" in problems(t7(rate="100 Hz"))["options.rate"]


def test_inputs_outputs_and_ranges_are_those_of_the_model():
    t8 = asked("T8", 4)
    channel = replace(t8.channels[0], input="AIN9")
    assert "a T8 has no input" in problems(replace(t8, channels=(channel,)))["channels.pressure.input"]
    assert "give 0 V to 5 V" in problems(replace(asked("T4"), outputs=t8.outputs))["outputs.pressure.scale"]
    assert "the step of 10 bits" in problems(replace(asked("T4"), outputs=t7().outputs))["outputs.pressure.resolution"]
    assert problems(asked("T8", ranges={"AIN2": "0.15 V"})) == {}
    assert "not known here" in problems(asked("T8", ranges={"AIN2": "1 V"}))["options.ranges.AIN2"]
    assert "are not set here" in problems(asked("T4", ranges={"AIN2": "1 V"}))["options.ranges"]


@pytest.mark.realtime
@pytest.mark.parametrize("model", ["T4", "T8"])
def test_it_measures_what_it_commands(model):
    with rig(asked(model)) as (emulator, _served, device):
        identity = device._identify_model(time.monotonic() + 1)
        assert (identity.model, identity.simulated) == (f"emulated unproven {model}", True)
        assert device.start(50.0) == 50.0
        assert device.start(500.0) == 100.0
        device.switch("FIO0", on=True)
        device.write("DAC0", 0.3 * FULL[model])
        time.sleep(0.6)
        block = device.collect()
        assert len(block.time) > 20
        assert all(later > earlier for earlier, later in pairwise(block.time))
        assert block.columns["pressure"][-1] == pytest.approx(3.0, abs=0.02)  # V: 100 kPa a volt
        assert emulator.plant.quantities()["pressure"] == pytest.approx(300e3, abs=1e6 * STEP[model] / FULL[model])
        assert device.arm_watchdog(1.0) == 1.0
        device.feed_watchdog()
        device.disarm_watchdog()
        device.stop()


@pytest.mark.realtime
def test_a_t8_has_its_ranges_set_and_all_inputs_taken_at_one_moment():
    """Inputs apart from each other, which cannot be read in one transaction."""
    t8 = asked("T8", ranges={"AIN4": "9.6 V"})
    apart = tuple(replace(channel, input=f"AIN{2 * i}") for i, channel in enumerate(t8.channels))
    with rig(replace(t8, channels=apart)) as (_, served, device):
        moments = []

        def quantities():
            moments.append(len(moments) + 1)
            return dict.fromkeys(("pressure", "displacement", "force", "pressure_command"), 0.01 * len(moments))

        served.t7._plant.quantities = quantities
        device.start(100.0)
        held = r.from_f32(device.get(r.AIN_RANGE, 16, time.monotonic() + 1, "range"))
        assert held[::2] == pytest.approx([11, 11, 9.6, 11])
        assert until(lambda: len(moments) > 10, 2)
        device.stop()
        time.sleep(0.05)
        columns = device.collect().columns
        for row in zip(*columns.values(), strict=True):
            si = [scale.to_si(volt) for (_name, _quantity, scale), volt in zip(CHANNELS, row, strict=True)]
            assert max(si) - min(si) < 1e-5


@pytest.mark.realtime
def test_another_stack_reads_the_same():
    """pymodbus by itself: AIN1, then what the others were at that moment at 650 and on; no stream can be begun."""
    with rig(asked("T8")) as (_, served, _device):
        host, port = served.address.split(":")
        client = ModbusTcpClient(host, port=int(port), timeout=1, retries=0)

        def f32(address):
            words = client.read_holding_registers(address, count=2).registers
            return client.convert_from_registers(words, client.DATATYPE.FLOAT32, word_order="big")

        try:
            assert f32(60000) == 8.0
            assert f32(2) == pytest.approx(f32(652))
            assert client.write_registers(4990, [0, 1]).isError()
            assert client.read_holding_registers(55000, count=1).registers == [2606]
        finally:
            client.close()


@pytest.mark.realtime
def test_a_silent_device_is_reported_and_a_ramp_is_stepped():
    with rig(asked("T8")) as (emulator, served, device):
        device.start(100.0)
        device.follow("DAC0", Segment("ramp", device._clock.now(), 0.0, 3.0, rate=10.0))
        assert until(lambda: [e["raw"] for e in emulator.log.of("set")][-1:] == [3.0], 3)
        served.faults.set("silence")
        assert until(lambda: isinstance(timed(device.collect)[1], DeviceError), 2)


@pytest.mark.realtime
def test_a_range_that_another_program_sets_shows():
    """At 0.6 V an input for 10 V reads 10 kPa of any pressure, without noise: a vent would be confirmed."""
    with rig(asked("T8")) as (_, served, device):
        device.start(100.0)
        before = device.held()
        assert before["ranges"] == "AIN0 11 V, AIN1 11 V, AIN2 11 V, AIN3 11 V"
        host, port = served.address.split(":")
        client = ModbusTcpClient(host, port=int(port), timeout=1, retries=0)
        try:
            words = client.convert_to_registers(0.6, client.DATATYPE.FLOAT32, word_order="big")
            assert not client.write_registers(40002, words).isError()
        finally:
            client.close()
        after = device.held()
        assert {name for name in after if after[name] != before[name]} - {"uptime"} == {"ranges"}
        assert after["ranges"] == "AIN0 11 V, AIN1 0.6 V, AIN2 11 V, AIN3 11 V"
