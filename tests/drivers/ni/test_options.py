"""What `check` says about an NI device in a bench file, each at its place."""

from dataclasses import replace

import pytest
from pmabench_drivers.ni_daq import NiDaq

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from pmabench.bench.compile import mount
from pmabench.bench.interface import InterlockRecord, ValveRecord
from pmabench.files.shipped import shipped_folder
from tests.drivers.ni.rigs import daq

SPECIMEN = shipped_folder("specimen") / "mas-20-250-paper0.yaml"


def problems(record):
    return dict(NiDaq.check(record))


def with_output(**changes):
    record = daq()
    return replace(record, outputs=(replace(record.outputs[0], **changes),))


def with_inputs(*inputs, **options):
    record = daq(channels=len(inputs), **options)
    return replace(record, channels=tuple(replace(c, input=i) for c, i in zip(record.channels, inputs, strict=True)))


def test_right_ones_have_no_problems():
    assert problems(daq(terminals={"ai0": "NRSE"}, ranges={"ai2": "0.2 V"})) == {}
    assert problems(daq(server="")) == {}
    assert problems(daq(server="daq-pc.lab")) == {}
    assert problems(with_inputs("ai0", "ai1", terminals={"ai0": "DIFF", "ai1": "DIFF"})) == {}


def test_the_port_of_the_server_is_the_usual_one_where_none_is_given():
    assert NiDaq(daq(server="192.168.0.30"), RealClock())._options.server == "192.168.0.30:31763"


@pytest.mark.parametrize(
    ("record", "place", "message"),
    [
        (daq(address=""), ("address",), 'for instance "Dev1"'),
        (daq(address="Dev1/ai0"), ("address",), "the name in NI-DAQmx"),
        (daq(serve="x"), ("options", "serve"), 'did you mean "server"'),
        (daq(server="a host"), ("options", "server"), "HOST:PORT"),
        (daq(server="127.0.0.1:99999"), ("options", "server"), "HOST:PORT"),
        (daq(terminals={"ai0": "SE"}), ("options", "terminals", "ai0"), 'did you mean "RSE"'),
        (daq(terminals={"ai9": "RSE"}), ("options", "terminals", "ai9"), 'no channel uses "ai9"'),
        (daq(ranges={"ai1": "2 V"}), ("options", "ranges", "ai1"), "is not known here"),
        (daq(watchdog=1.0), ("watchdog",), "hold their last value when the computer dies"),
        (with_inputs("ai32"), ("channels", "pressure", "input"), "ai0 to ai31"),
        (with_inputs("ai0", "ai0"), ("channels", "displacement", "input"), "in use by pressure"),
        (with_inputs("ai8", "ai0", terminals={"ai0": "DIFF"}), ("channels", "displacement", "input"), "ai8 is in use"),
        (with_inputs("ai9", terminals={"ai9": "DIFF"}), ("channels", "pressure", "input"), "cannot be measured diff"),
        (
            replace(daq(), channels=(replace(daq().channels[0], raw_unit="count"),)),
            ("channels", "pressure", "input"),
            "V",
        ),
        (with_output(output="ao2"), ("outputs", "pressure", "output"), "known: ao0, ao1"),
        (with_output(high=1.01e6), ("outputs", "pressure", "scale"), "-10 V to 10 V"),
        (with_output(resolution=0.0), ("outputs", "pressure", "resolution"), "0.000306 V"),
        (
            replace(daq(), valves=(ValveRecord("v", "daq", "port2/line0"),)),
            ("outputs", "v", "output"),
            "no digital line",
        ),
        (
            replace(daq(), interlocks=(InterlockRecord("i", "daq", "port1/line0"),)),
            ("interlocks", "i", "input"),
            "in use by dump_valve",
        ),
    ],
)
def test_every_mistake_is_reported_at_its_place(record, place, message):
    found = problems(record)
    assert message in found[place]
    with pytest.raises(DeviceError):
        NiDaq(record, RealClock())


def test_the_shipped_bench_shows_of_the_missing_watchdog_and_names_the_remedy(tmp_path):
    folder = shipped_folder("bench")
    shipped = mount(folder / "ni.yaml", SPECIMEN)
    assert [line for line in shipped.lacks if "no watchdog of daq, accepted by" in line]
    (tmp_path / "calibrations").symlink_to(folder / "calibrations")
    text = (folder / "ni.yaml").read_text()
    start, end = text.index("no_watchdog:"), text.index("devices:")
    (tmp_path / "ni.yaml").write_text(text[:start] + text[end:])
    [line] = [line for line in mount(tmp_path / "ni.yaml", SPECIMEN).lacks if "watchdog" in line]
    assert "a computer that dies leaves the pressure at its last value" in line
    assert "else a normally-open dump valve on one that has" in line
