"""`pmabench bench read` and `set`: one channel of a bench, and one output by hand."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import DeviceError, UsageError, did_you_mean
from pmabench.base.quantities import CHANNEL_QUANTITY, QUANTITIES, show
from pmabench.cli.common import Ui, common, fields, read_quantity
from pmabench.cli.names import BENCH, PATH, SPECIMEN
from pmabench.cli.operator import AtLines
from pmabench.cli.outcome import show_outcome
from pmabench.engine.operator import ConfirmedBeforehand, Operator

if TYPE_CHECKING:
    from pmabench.bench.interface import ChannelRecord
    from pmabench.session.guided import Look, Reading, Series
    from pmabench.session.jog import Jog

PIECE = 0.1
"""How long is listened at once [s]."""
PATIENCE = 3.0
"""How long a first sample is waited for [s]."""
SHOWN = 1.0
"""While an output is held, a line so often [s]."""


@click.command(name="read")
@click.argument("bench", type=BENCH)
@click.argument("channel")
@click.option(
    "--for", "lasting", metavar="TIME", help='Mean, noise and drift over so long: "2 s"; else the newest sample.'
)
@click.option("--rate", metavar="RATE", default="100 Hz", show_default=True, help="Rate at which devices sample.")
@common
def read(ui: Ui, bench: str, channel: str, lasting: str | None, rate: str) -> None:
    """Read one CHANNEL of BENCH: its value with unit, and what the device gave. Arms nothing and commands nothing."""
    from pmabench.cli.prepare import mounted_of
    from pmabench.session.guided import looking

    seconds = None if lasting is None else _above_zero(lasting, "time", "--for")
    hertz = _above_zero(rate, "frequency", "--rate")
    compiled = mounted_of(bench).bench
    known = {record.name: record for record in compiled.channels}
    if channel not in known:
        raise UsageError(f'"{compiled.name}" has no channel "{channel}"{did_you_mean(channel, known)}')
    record = known[channel]
    with looking(compiled, hertz) as look:
        reading = _listen(look, record, seconds)
        identity, used = look.identities[record.device], look.acquisition.rates[record.device]
    data = _reading_json(record, reading, used, averaged=seconds is not None)
    data |= {"bench": compiled.name, "simulated": identity.simulated}
    ui.result(data, lambda: _print_reading(record, reading, data), [f"{reading.mean:.9g} {data['unit']}"])


def _above_zero(text: str, quantity: str, option: str) -> float:
    value = read_quantity(option, text, quantity)
    if not value > 0:
        raise UsageError(f'{option}: "{text}" is not above zero')
    return value


def _listen(look: Look, record: ChannelRecord, seconds: float | None) -> Reading:
    """The newest sample, or what `seconds` [s] of samples say; raises DeviceError where none comes."""
    from pmabench.session.guided import Reading, listen

    clock = look.acquisition.clock
    until = clock.now() + PATIENCE
    series = None
    while series is None and clock.now() < until:
        series = listen(look.acquisition, PIECE).get(record.name)
    if series is not None and seconds is not None:
        series = listen(look.acquisition, seconds).get(record.name)
    if series is None:
        lasted = PATIENCE if seconds is None else max(PATIENCE, seconds)
        raise DeviceError(record.device, f"gives no sample within {lasted:g} s; look at its wire", record.input)
    if seconds is None:
        return Reading(float(series.y[-1]), 0.0, 0.0, 1)
    return series.reading()


def _reading_json(record: ChannelRecord, reading: Reading, rate: float, *, averaged: bool) -> dict[str, Any]:
    """The documented object; numbers that are none, as those of a broken wire, are null."""

    def number(value: float) -> float | None:
        return value if isfinite(value) else None

    return {
        "schema": "pmabench.reading/1",
        "channel": record.name,
        **fields(record, "device", "input", "quantity", "raw_unit"),
        "value": number(reading.mean),
        "unit": QUANTITIES[record.quantity].unit,
        "raw": number(float(record.scale.to_raw(reading.mean))),
        "noise": number(reading.noise) if averaged else None,
        "drift": number(reading.drift) if averaged else None,
        "samples": reading.count,
        "rate": rate,
        "in_range": bool(record.low <= reading.mean <= record.high),
    }


def _print_reading(record: ChannelRecord, reading: Reading, data: Mapping[str, Any]) -> None:
    def shown(value: float, digits: int) -> str:
        return show(value, record.quantity, digits)

    raw = "" if data["raw"] is None else f"{data['raw']:.6g}"
    click.echo(
        f"{record.name}  {shown(reading.mean, 6)}   raw {raw} {record.raw_unit}   {record.device}.{record.input}"
    )
    if data["noise"] is not None:
        noise, drift = shown(reading.noise, 2), shown(reading.drift, 2)
        click.echo(f"mean of {reading.count} samples at {data['rate']:g} Hz; noise {noise} rms, drift {drift}")
    if not data["in_range"]:
        ends = f"{shown(record.low, 6)} to {shown(record.high, 6)}"
        click.echo(f"this is outside what the channel can measure, {ends}: look at the sensor and its wire")
    if data["simulated"]:
        click.echo("SIMULATED")


@click.command(name="set")
@click.argument("bench", type=BENCH)
@click.argument("output")
@click.argument("value")
@click.option("--specimen", type=SPECIMEN, required=True, help="The specimen that is mounted; its limits hold.")
@click.option("--for", "lasting", metavar="TIME", help='Hold for so long: "10 s"; else until Ctrl-C.')
@click.option("--out", default="runs", show_default=True, type=PATH, help="Where run folders go.")
@click.option("--operator", default="", help="Who is at the bench; the login name if not given.")
@click.option("--yes", is_flag=True, help="The question counts as answered; the record says so.")
@common
def set_(
    ui: Ui, bench: str, output: str, value: str, specimen: str, lasting: str | None, out: Path, operator: str, yes: bool
) -> int:
    """Send OUTPUT of BENCH to VALUE ("50 kPa") by hand, hold it, and leave the bench in its safe state.

    At most the bench's set-up pressure, as with monitor --jog: after the proof test, under every limit, recorded as a
    run of kind setup. It ends by --for or by Ctrl-C, and vents on every way out.
    """
    from pmabench.cli.prepare import mounted_of
    from pmabench.session.jog import hold_at

    seconds = None if lasting is None else _above_zero(lasting, "time", "--for")
    mounted = mounted_of(bench, specimen)
    known = {record.name: record for record in mounted.bench.outputs}
    if output not in known:
        valve = output in mounted.bench_file.valves
        what = "is a valve, which runs and the safe state switch" if valve else "is not there"
        raise UsageError(f'the output "{output}" of "{mounted.bench.name}" {what}{did_you_mean(output, known)}')
    wanted = read_quantity(output, value, known[output].quantity)
    if not (yes or sys.stdin.isatty()):
        raise UsageError("this moves the bench, and there is no terminal to ask at; with --yes it counts as answered")
    asked: Operator = ConfirmedBeforehand() if yes else AtLines(realtime=mounted.bench.realtime)
    outcome = hold_at(
        mounted, output, wanted, asked, out, _Lines(ui, paced=seconds is None), seconds=seconds, operator_name=operator
    )
    show_outcome(ui, outcome)
    return outcome.exit_code


class _Lines:
    """A line a second with what every channel measures; `paced`: virtual time goes no faster than the clock."""

    def __init__(self, ui: Ui, *, paced: bool) -> None:
        self._ui, self._paced = ui, paced
        self._due = 0.0

    def __call__(self, series: Mapping[str, Series], work: Jog) -> None:
        """Called ten times a second of bench time."""
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + SHOWN
            measured = "   ".join(
                f"{name} {show(one.mean(), CHANNEL_QUANTITY[name], 4)}" for name, one in series.items()
            )
            self._ui.note(f"{work.settings()}   measured {measured}")
        if self._paced and not work.executor.bench.realtime:
            time.sleep(PIECE)
