"""A protocol that asks for more samples than a device can give is warned of with the places of both rates."""

import re

import pytest

from pmabench.files.shipped import find_file
from tests.cli.test_cli import call

CHECK = ["check", "contraction-relaxation", "--bench", "wires", "--specimen", "mas-20-250-paper0"]


def reported(*more):
    """Device -> protocol's rate, device's rate, file and line of each, of what `check` warns of."""
    found = {}
    for line in call(*CHECK, *more, "--quiet").stdout.splitlines():
        match = re.match(
            r"(.+):(\d+):\d+  (\S+) Hz is more than (\w+) gives, (\S+) Hz \((\S+):(\d+):\d+\): (.*) recorded", line
        )
        if match:
            protocol, at, asked, device, gives, file, there, names = match.groups()
            found[device] = (float(asked), float(gives), (protocol, int(at)), (file, int(there)), names)
    return found


def line_of(path, text):
    return 1 + [line.strip().startswith(text) for line in path.read_text().splitlines()].index(True)


def test_each_device_that_is_slower_is_named_with_both_places():
    found = reported()
    protocol, bench = (find_file(*what) for what in (("protocol", CHECK[1]), ("bench", CHECK[3])))
    registers = bench.parent / "registers" / "pressure-regulator.yaml"
    rates = {device: (asked, gives) for device, (asked, gives, *_) in found.items()}
    assert rates == {"regulator": (500.0, 100.0), "load_cell": (500.0, 50.0), "gauge": (500.0, 100.0)}
    for _, _, (file, line), _, _ in found.values():
        assert file.endswith(protocol.name)
        assert line == line_of(protocol, "sample_rate")
    (file, line), names = found["regulator"][3:]
    assert file.endswith("registers/pressure-regulator.yaml")
    assert line == line_of(registers, "rate")
    assert names == "pressure, pressure_command are"
    (file, line), names = found["load_cell"][3:]
    assert (line, names) == (line_of(bench, "rate: 50 Hz"), "force is")


@pytest.mark.parametrize(("rate", "slow"), [("100 Hz", {"load_cell"}), ("50 Hz", set())])
def test_a_rate_that_a_device_gives_is_not_warned_of(rate, slow):
    assert set(reported("--set", f"sample_rate={rate}")) == slow


def test_a_channel_that_is_not_recorded_is_not_warned_of():
    assert set(reported("--set", "record=[pressure, displacement]")) == {"regulator", "gauge"}


def test_a_stream_timed_by_the_device_is_asked_for_its_most_over_all_channels():
    """A LabJack T7 takes 100 000 samples a second over all channels."""
    bench = ["--bench", "labjack", "--specimen", "mas-20-250-paper0", "--quiet"]  # four channels
    for rate, warned in ((25_000, False), (25_100, True)):
        said = call("check", CHECK[1], *bench, "--set", f"sample_rate={rate} Hz").stdout
        assert ("is more than t7 gives, 25000 Hz" in said) == warned
