"""What a bench file may say of a board, read strictly; touches no port. Standard library only."""

from __future__ import annotations

from pmabench.bench.interface import DeviceRecord
from pmabench_drivers.serial_line_daq.wire import MOST, NAMES, index_of
from pmabench_drivers.shared.options import BAUDS, Reader

KNOWN_BAUDS = tuple(sorted({*BAUDS, 250_000, 500_000, 1_000_000, 2_000_000}))
BAUD = 500_000
WATCHDOG = (0.05, 1.0)
"""Shortest and longest time of the board's watchdog [s]."""


def read_options(device: DeviceRecord, reader: Reader) -> int:
    """The baud rate; everything that the board could not do with this device is noted in `reader`."""
    given = reader.keys(device.options, ("options",), ("baud",))
    reader.port(device, "/dev/ttyACM0")
    baud = reader.one_of(given, "baud", ("options",), KNOWN_BAUDS, BAUD)
    for channel in device.channels:
        _named(reader, ("channels", channel.name, "input"), channel.input, "a")
    for interlock in device.interlocks:
        _named(reader, ("interlocks", interlock.name, "input"), interlock.input, "d")
    for output in device.outputs:
        place = "outputs", output.name
        _named(reader, (*place, "output"), output.output, "o")
        if output.resolution < 1 or output.resolution != round(output.resolution):
            reader.fault(place, 'the board takes whole counts: "resolution: 1 count" is expected')
        if abs(float(output.scale.to_raw(output.safe))) > 1e-6:
            reader.fault(place, "the board vents to 0 counts: the scale must have the safe value there")
    for valve in device.valves:
        _named(reader, ("outputs", valve.name, "output"), valve.output, "v")
        if valve.energised == valve.safe:
            message = f'the board vents with its valves off: "{valve.name}" must be {valve.safe} without power'
            reader.fault(("outputs", valve.name, "energised"), message)
    shortest, longest = WATCHDOG
    if (device.outputs or device.valves) and not device.watchdog:
        reader.fault(
            (), f'outputs work only under the watchdog of the board: add "watchdog: 500 ms" (at most {longest:g} s)'
        )
    elif device.watchdog and not shortest <= device.watchdog <= longest:
        reader.fault(("watchdog",), f"the board's watchdog takes {shortest * 1e3:g} ms to {longest:g} s")
    return baud


def _named(reader: Reader, place: tuple[str, ...], name: str, letter: str) -> None:
    if index_of(name, letter) is None:
        last = MOST[letter] - 1
        reader.fault(place, f'a {NAMES[letter]} of the board is expected, {letter}0 to {letter}{last}, not "{name}"')
