"""What `check` says about a T7 in a bench file, each at its place."""

from dataclasses import replace

import pytest
from pmabench_drivers.labjack import LabJack

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from pmabench.bench.interface import InterlockRecord, ValveRecord
from tests.drivers.labjack.rigs import t7


def problems(record):
    return dict(LabJack.check(record))


def with_output(**changes):
    record = t7()
    return replace(record, outputs=(replace(record.outputs[0], **changes),))


def test_a_right_one_has_no_problems():
    assert problems(t7(ranges={"AIN2": "1 V"}, settling="50 us", resolution_index=3)) == {}
    assert problems(t7(address="192.168.0.20")) == {}
    assert problems(t7(channels=1, differential=["AIN0"])) == {}


@pytest.mark.parametrize(
    ("record", "place", "message"),
    [
        (t7(address="labjack.local"), ("address",), "an IP address"),
        (t7(address="192.168.0.20:99999"), ("address",), "an IP address"),
        (t7(streamport=1), ("options", "streamport"), 'did you mean "stream_port"'),
        (t7(stream_port=0), ("options", "stream_port"), "from 1 to 65535"),
        (t7(resolution_index=9), ("options", "resolution_index"), "from 0 to 8"),
        (t7(settling=50), ("options", "settling"), "a time with its unit"),
        (t7(ranges={"AIN2": "5 V"}), ("options", "ranges", "AIN2"), "is not known here"),
        (t7(ranges={"AIN9": "1 V"}), ("options", "ranges", "AIN9"), "no channel uses"),
        (t7(differential=["AIN0"]), ("options", "differential"), "with the next one free"),
        (t7(differential=["AIN1"]), ("options", "differential"), "an even input is needed"),
        (t7(watchdog=0.5), ("watchdog",), "whole seconds"),
        (with_output(output="DAC2"), ("outputs", "pressure", "output"), 'did you mean "DAC'),
        (with_output(output="TDAC0"), ("outputs", "pressure", "output"), "known: DAC0, DAC1"),
        (with_output(high=1.1e6), ("outputs", "pressure", "scale"), "0 V to 5 V"),
        (with_output(low=-1e4), ("outputs", "pressure", "scale"), "0 V to 5 V"),
        (with_output(resolution=0.0), ("outputs", "pressure", "resolution"), "1.22 mV"),
        (replace(t7(), valves=(ValveRecord("v", "t7", "FIO9"),)), ("outputs", "v", "output"), "no digital line"),
        (replace(t7(), interlocks=(InterlockRecord("i", "t7", "DIO0"),)), ("interlocks", "i", "input"), "in use"),
        (
            replace(t7(), channels=(replace(t7().channels[0], input="AIN14"),)),
            ("channels", "pressure", "input"),
            "AIN0 to AIN13",
        ),
        (
            replace(t7(), channels=(t7().channels[0], replace(t7().channels[1], input="AIN0"))),
            ("channels", "pressure", "input"),
            "two channels",
        ),
        (
            replace(t7(), channels=(replace(t7().channels[0], raw_type="int32"),)),
            ("channels", "pressure", "input"),
            "gives volts",
        ),
    ],
)
def test_mistakes_are_named_at_their_place(record, place, message):
    found = problems(record)
    assert message in found[place]
    with pytest.raises(DeviceError):
        LabJack(record, RealClock())
