"""Addresses of modules, and what a bench file may say of a terminal."""

from dataclasses import replace

import pytest
from pmabench_drivers.festo_cpx_e import FestoCpxE
from pmabench_drivers.festo_cpx_e.terminal import build, read_options
from pmabench_drivers.shared.options import Reader

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError
from pmabench.bench.compile import mount
from pmabench.bench.interface import Scale
from pmabench.files.shipped import shipped_folder
from tests.drivers.festo.rigs import terminal


def test_addresses_are_those_of_the_makers_own_rig():
    """EP, 16DI, 8DO, 4AI-UI, 4AO-UI: the addresses that the maker's system tests expect of their hardware."""
    modules = build(("16di", "8do", "4ai-ui", "4ao-ui"))
    assert [(m.first_output, m.first_input) for m in modules] == [
        (40003, 45395),
        (40003, 45397),
        (40004, 45399),
        (40004, 45404),
    ]
    assert build(("16di", "8do", "4ai-ui", "4ao-ui", "8do"))[-1].first_output == 40008
    assert build(("16di", "8do", "4ai-ui", "4ao-ui", "8do"))[-1].first_input == 45409
    assert [m.parameter(0) for m in modules] == [4828 + 64 * place for place in (1, 2, 3, 4)]


def test_ranges_stand_two_in_a_parameter():
    """4AO-UI: parameters 11 and 12; 4AI-UI: 13 and 14; the first channel of each pair in the lower four bits."""
    *_, ai, ao = build(("16di", "8do", "4ai-ui", "4ao-ui"))
    assert [ao.range_of(channel) for channel in range(4)] == [(5095, 0), (5095, 4), (5096, 0), (5096, 4)]
    assert [ai.range_of(channel) for channel in range(4)] == [(5033, 0), (5033, 4), (5034, 0), (5034, 4)]


def test_channels_are_where_their_module_is():
    reader = Reader()
    found = read_options(terminal(), reader).terminal
    assert reader.problems == []
    inputs, outputs = found.inputs(), found.outputs()
    assert (inputs["di1.15"].address, inputs["di1.15"].bit) == (45395, 15)
    assert (inputs["do2.7"].address, inputs["do2.7"].bit) == (45397, 7)
    assert (inputs["ai3.3"].address, inputs["ai3.3"].type) == (45402, "int16")
    assert (inputs["ao4.0"].address, outputs["ao4.3"].address) == (45404, 40007)
    assert (outputs["do2.0"].address, outputs["do2.0"].bit) == (40003, 0)
    assert len(inputs) == 16 + 8 + 4 + 4
    assert len(outputs) == 8 + 4
    assert found.width == 14


WRONG = {
    "no modules": ({"modules": []}, ("options", "modules"), "1 to 25 modules"),
    "an unknown module": ({"modules": ["16di", "4ai_ui"]}, ("options", "modules"), 'did you mean "4ai-ui"'),
    "an unknown key": ({"range": {}}, ("options", "range"), 'did you mean "ranges"'),
    "an unknown range": ({"ranges": {"ai3.0": "0-10 V"}}, ("options", "ranges", "ai3.0"), 'did you mean "0..10 V"'),
    "a range of nothing": ({"ranges": {"ai9.0": "0..10 V"}}, ("options", "ranges", "ai9.0"), 'channel "ai9.0"'),
    "a range of a digital channel": ({"ranges": {"di1.0": "0..10 V"}}, ("options", "ranges", "di1.0"), "no analogue"),
    "no range of a used channel": (
        {"ranges": {"ai3.0": "0..10 V", "ai3.1": "-10..10 V"}},
        ("options", "ranges"),
        '"ao4.0" is used and has no range',
    ),
    "modules in another order": (
        {"modules": ["8do", "16di", "4ai-ui", "4ao-ui"]},
        ("outputs", "dump_valve", "output"),
        'the modules have no "do2.0"; did you mean "do1.0"',
    ),
    "too fast": ({"rate": "1 kHz"}, ("options", "rate"), "outside 0.1 to 500 Hz"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_option_is_named_at_its_place(what):
    changes, place, message = WRONG[what]
    found = list(FestoCpxE.check(terminal(**changes)))
    assert any(at == place and message in text for at, text in found), found
    with pytest.raises(DeviceError, match="^terminal: "):
        FestoCpxE(terminal(**changes), RealClock())


def test_what_the_bench_asks_must_fit_the_module():
    def messages(**changes):
        return [(place, text) for place, text in FestoCpxE.check(replace(terminal(), **changes))]

    assert messages() == []
    [output], [valve] = terminal().outputs, terminal().valves
    [(place, text)] = messages(outputs=(replace(output, output="ai3.0"),))
    assert place == ("outputs", "pressure", "output")
    assert 'have no "ai3.0"' in text
    [(_, text)] = messages(outputs=(replace(output, scale=Scale(1e6 / 32000, -1e5)),))
    assert "its safe value is 3200 counts, and without communication the terminal puts out 0" in text
    [(_, text)] = messages(outputs=(replace(output, high=1.2e6),))
    assert "38400 is outside 0 to 32767" in text
    [(_, text)] = messages(outputs=(replace(output, low=-1e4),))
    assert "-320 is outside 0 to 32767" in text
    [(place, text)] = messages(valves=(replace(valve, energised="open"),))
    assert place == ("outputs", "dump_valve", "output")
    assert "is open in the safe state only while it is energised" in text
    assert messages(valves=(replace(valve, energised="open"),), watchdog=0.0) == []
    [(place, text)] = messages(watchdog=0.05)
    assert place == ("watchdog",)
    assert "0.1 to 65.535 s, not 0.05 s" in text
    assert len(messages(watchdog=70.0)) == 1
    first = terminal().channels[0]
    [(place, text)] = messages(channels=(replace(first, raw_type="float64", raw_unit="V"),))
    assert place == ("channels", "pressure", "input")
    assert "gives counts" in text


@pytest.mark.parametrize("address", ["", "cpx", "192.168.1.1", "/dev/ttyUSB0", "192.168.1.1:99999"])
def test_an_address_is_a_number_with_a_port(address):
    [(place, message)] = FestoCpxE.check(terminal(address))
    assert place == ("address",)
    assert '"192.168.1.1:502"' in message


def test_the_shipped_bench_compiles():
    mounted = mount(shipped_folder("bench") / "festo.yaml", shipped_folder("specimen") / "mas-20-250-paper0.yaml")
    [device] = mounted.bench.devices
    assert device.guarded
    assert list(FestoCpxE.check(device)) == []
    [output] = device.outputs
    assert output.scale.to_raw(1e6) == pytest.approx(32000)
