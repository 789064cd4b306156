"""Truth files of rigs: what they say in SI, how every mistake is placed, and that no bench file is their source."""

import re

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.bench.compile import mount_alone
from pmabench.bench.truth import read_truth, truth_of
from pmabench.files.shipped import find_file, shipped_folder

EMULATED = (
    "festo",
    "festo-sine",
    "labjack",
    "labjack-t8",
    "ni",
    "can",
    "serial",
    "serial-line-daq",
    "alicat",
    "dataq",
    "wires",
)
GOOD = """\
schema: pmabench.truth/1
name: a rig
devices:
  terminal:
    driver: festo-cpx-e
    options: {modules: [16di, 8do, 4ai-ui, 4ao-ui], ranges: {ai3.0: 0..10 V, ao4.0: 0..10 V}}
    inputs:
      ai3.0:
        measures: pressure
        sensor: [[2 V, 0 bar], [10 V, 8 bar]]
        device: [[0 count, 0 V], [32000 count, 10 V]]
        source: a data sheet
    outputs:
      ao4.0: {drives: pressure, actuator: [[0 V, 0 bar], [10 V, 10 bar]], device: [[0 count, 0 V], [32000 count, 10 V]], source: a data sheet}
    valves:
      do2.0: {valve: dump_valve, energised: closed, source: a data sheet}
    contacts:
      di1.0: {contact: e-stop, released: high, source: a data sheet}
"""


def written(tmp_path, *changes):
    text = GOOD
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    return path


def test_sensor_and_device_are_put_together_in_si(tmp_path):
    device = read_truth(written(tmp_path)).devices["terminal"]
    [channel], [output] = device.channels, device.outputs
    # 16000 counts are 5 V, which are 3 V above the 2 V of 0 bar, of 1 V a bar
    assert channel.scale.to_si(16000) == pytest.approx(3e5)
    assert (channel.name, channel.input, channel.raw_unit, channel.raw_type) == ("pressure", "ai3.0", "count", "int32")
    assert output.scale.to_raw(2.5e5) == pytest.approx(8000)
    assert [(v.output, v.energised) for v in device.valves] == [("do2.0", "closed")]
    assert [(lock.name, lock.input, lock.safe) for lock in device.interlocks] == [("e-stop", "di1.0", "high")]


@pytest.mark.parametrize(
    ("old", "new", "line", "column", "message"),
    [
        ("festo-cpx-e", "festo-cpx", 5, 13, 'did you mean "festo-cpx-e"'),
        ("measures: pressure", "measures: presure", 9, 19, "pressure"),
        ("sensor: [[2 V, 0 bar], [10 V, 8 bar]]", "sensor: [[2 V, 0 mm], [10 V, 8 bar]]", 10, 24, "mm"),
        (
            "sensor: [[2 V, 0 bar], [10 V, 8 bar]]",
            "sensor: [[2 V, 0 bar], [10 mA, 8 bar]]",
            10,
            33,
            "both in one unit, here V",
        ),
        ("sensor: [[2 V, 0 bar], [10 V, 8 bar]]", "sensor: [[2 mA, 0 bar], [10 mA, 8 bar]]", 11, 28, "is in mA"),
        ("sensor: [[2 V, 0 bar], [10 V, 8 bar]]", "sensor: [[2 V, 8 bar], [10 V, 8 bar]]", 10, 17, "they make no line"),
        ("      ai3.0:\n", "      ai3.7:\n", 9, 9, 'no "ai3.7"'),
        ("modules: [16di", "modules: [17di", 6, 24, 'did you mean "16di"'),
        ("        source: a data sheet\n    outputs", "    outputs", 9, 9, "source"),
        ("contact: e-stop", "contact: e-stop, level: 1", 18, 32, "level"),
    ],
)
def test_every_mistake_has_its_place(tmp_path, old, new, line, column, message):
    with pytest.raises(InvalidFile) as refused:
        read_truth(written(tmp_path, (old, new)))
    found = [(problem.line, problem.column, problem.message) for problem in refused.value.problems]
    assert any((a, b) == (line, column) and message in text for a, b, text in found), found


@pytest.mark.parametrize("name", EMULATED)
def test_the_truth_of_a_shipped_bench_is_found_and_takes_nothing_from_the_bench(name):
    path = truth_of(find_file("bench", name))
    assert path is not None
    text = path.read_text()
    assert set(read_truth(path).devices) == {
        device.name for device in mount_alone(find_file("bench", name)).bench.devices
    }
    assert not re.search(r"benches|calibration|include", text)


def test_a_bench_of_ones_own_has_no_truth(tmp_path):
    path = tmp_path / "labjack.yaml"
    path.write_text((shipped_folder("bench") / "labjack.yaml").read_text())
    assert truth_of(path) is None
