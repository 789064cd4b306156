"""`pmabench bench`: its card to hang at the rig, what its devices answer, one channel, and one output by hand."""

from __future__ import annotations

import datetime
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.clock import RealClock
from pmabench.base.errors import DeviceError, UsageError, did_you_mean
from pmabench.base.quantities import CHANNEL_QUANTITY, QUANTITIES, show
from pmabench.cli.common import Group, Ui, common, fields, read_quantity, recorded_options
from pmabench.cli.names import BENCH, HTML, SPECIMEN
from pmabench.cli.outcome import at_terminal, outcome_json, print_checks, print_outcome, progress_line, show_outcome
from pmabench.report.terminal import print_grid, print_texts

if TYPE_CHECKING:
    from pmabench.bench.interface import ChannelRecord, DeviceRecord, Identity
    from pmabench.session.checks import Check
    from pmabench.session.guided import Jog, Look, Reading, Series


@click.group(name="bench", cls=Group)
def command() -> None:
    """A bench: its card for people at the rig; ask its devices, read one channel, set one output."""


@command.command(name="card")
@click.argument("bench", type=BENCH)
@click.option(
    "--specimen", type=SPECIMEN, help="Specimen file, or the name of a shipped one: its limits are counted in."
)
@click.option("-o", "--output", required=True, type=HTML, help="The HTML file.")
@common
def card(ui: Ui, bench: str, specimen: str | None, output: Path) -> None:
    """Write the card of BENCH: limits, what vents, what happens when something fails, wiring.

    One A4 page, two if it has very much.
    """
    from pmabench.bench.card import make_card
    from pmabench.cli.prepare import mounted_of
    from pmabench.report.writing import write_card

    made = make_card(mounted_of(bench, specimen), datetime.date.today().isoformat())
    write_card(asdict(made), output)
    ui.result({"schema": "pmabench.bench-card/1", "path": str(output)}, lambda: click.echo(str(output)))


@command.command(name="probe")
@click.argument("bench", type=BENCH, required=False)
@click.option("--driver", help="Without a bench file: a driver's name, or module:Class; needs --address.")
@click.option("--address", help="Where its device is, as a bench file says it.")
@click.option("--option", "options", multiple=True, metavar="NAME=VALUE", help="An option of the driver.")
@click.option("--self-test", "test", is_flag=True, help="Try the bench under a small pressure; needs --specimen.")
@click.option("--specimen", type=SPECIMEN, help="The specimen that is mounted; its limits hold during the self-test.")
@recorded_options
@click.option("--yes", is_flag=True, help="Every prompt of the self-test counts as answered; the record says so.")
@common
def probe(
    ui: Ui,
    bench: str | None,
    driver: str | None,
    address: str | None,
    options: tuple[str, ...],
    specimen: str | None,
    *,
    test: bool,
    **how: Any,
) -> int | None:
    """Open the devices of BENCH, show who answers and one value of each channel, and close; nothing is commanded.

    With --driver and --address: the one device there, before there is a bench file.
    """
    if (bench is None) == (driver is None) or (driver is None) != (address is None) or (test and bench is None):
        raise UsageError("give a BENCH, or --driver and --address of one device")
    name: str | None = None
    channels: list[dict[str, Any]] = []
    if driver is not None and address is not None:
        identities = who_answers(driver, address, options)
    elif test:
        if specimen is None:
            raise UsageError("--self-test puts pressure on the muscle: say which one is mounted, with --specimen")
        return _self_test(ui, str(bench), specimen, **how)
    else:
        name, identities, channels = _read_once(str(bench))
    data = {"schema": "pmabench.probe/1", "bench": name, "devices": identities, "channels": channels}
    ui.result(data, lambda: _print_probe(ui, identities, channels))
    silent = [row for row in channels if row["value"] is None]
    if silent:
        raise DeviceError(str(silent[0]["device"]), "gives no samples", str(silent[0]["channel"]))
    return None


def _read_once(bench: str) -> tuple[str, dict[str, dict[str, Any]], list[dict[str, Any]]]:
    """Name of the bench, identity of each device, and a row per channel with its mean and noise over half a second."""
    from pmabench.cli.prepare import mounted_of
    from pmabench.session.guided import listen, looking

    compiled = mounted_of(bench).bench
    with looking(compiled) as look:
        series = listen(look.acquisition, 0.5)
        identities = {device.name: _about(device, look.identities[device.name]) for device in compiled.devices}
    channels = []
    for channel in compiled.channels:
        one = series.get(channel.name)
        reading = one.reading() if one is not None else None
        about = {"channel": channel.name} | fields(channel, "device", "input", "quantity", "raw_unit")
        measured = (channel.scale.to_raw(reading.mean), reading.mean, reading.noise) if reading else (None,) * 3
        channels.append(about | dict(zip(("raw", "value", "noise"), measured, strict=True)))
    return compiled.name, identities, channels


def _about(device: DeviceRecord, identity: Identity) -> dict[str, Any]:
    from pmabench.engine.bench_checks import doubt

    return {**vars(identity), "verified": device.verified, "doubt": doubt(device, identity)}


def _print_probe(ui: Ui, identities: dict[str, dict[str, Any]], channels: Sequence[dict[str, Any]]) -> None:
    console = ui.console()
    known = identities.items()
    rows = [[name, f"{i['maker']} {i['model']}", i["serial"], i["firmware"], _proven(i)] for name, i in known]
    print_texts(console, ["device", "answers as", "serial", "firmware", ""], rows)
    if not channels:
        return
    console.print()
    table = []
    for row in channels:
        values = ["no sample", "", ""]
        if row["value"] is not None:
            measured = [show(row[name], row["quantity"], digits) for name, digits in (("value", 5), ("noise", 2))]
            values = [f"{row['raw']:.6g} {row['raw_unit']}", *measured]
        table.append([row["channel"], f"{row['device']}.{row['input']}", *values])
    print_grid(console, ["channel", "wire", "raw", "value", "noise (rms)"], table, ("channel", "wire"))


def _proven(identity: dict[str, Any]) -> str:
    """Whether a device is simulated, and its scales not proven by that, or what its driver was verified on."""
    from pmabench.bench.interface import UNPROVEN

    if identity["simulated"]:
        return "SIMULATED, scales not proven" if identity["model"].startswith(UNPROVEN) else "SIMULATED"
    return f"verified: {identity['doubt'] or identity['verified']}"


def _self_test(ui: Ui, bench: str, specimen: str, out: Path, operator: str, *, yes: bool) -> int:
    from pmabench.cli.prepare import mounted_of
    from pmabench.session.self_test import run_self_test
    from pmabench.store.folder import read_manifest

    mounted = mounted_of(bench, specimen)
    person = at_terminal(mounted.bench, yes=yes, there=sys.stdin.isatty())
    tables: list[Sequence[Check]] = []
    with progress_line(ui, "self-test") as progress:
        outcome = run_self_test(mounted, person, out, operator_name=operator, report=tables.append, progress=progress)
    checks = tables[0] if tables else ()
    unproven = read_manifest(outcome.folder).get("scales_not_proven", []) if outcome.folder is not None else []
    data = {
        "schema": "pmabench.self-test/1",
        "checks": [asdict(check) for check in checks],
        "outcome": outcome_json(outcome),
        "scales_not_proven": unproven,
    }

    def human() -> None:
        print_checks(ui, checks)
        if unproven:
            ui.note(f"scales not proven: the emulator of {', '.join(unproven)} takes them from this bench file")
        print_outcome(outcome)

    ui.result(data, human)
    return outcome.exit_code


def who_answers(driver: str, address: str, options: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Open a device by the name of its driver (or `module:Class`) and its address, ask who it is, and close.

    `options` are those of a bench file, as name=value. Raises UsageError where they cannot be read, DeviceError where
    the driver refuses them or nobody answers.
    """
    from pmabench.bench.driver_options import driver_class, verified
    from pmabench.bench.interface import DeviceRecord
    from pmabench.guard.links import OPENS_WITHIN, load_driver
    from pmabench.guard.owner import Owner

    try:
        target = driver_class(driver)
    except ValueError as error:
        raise UsageError(f"--driver: {error}; or give module:Class") from error
    record = DeviceRecord("device", target, address, dict(_option(text) for text in options))
    device = load_driver(record, RealClock())
    owner = Owner(record.name)
    try:
        identity = owner.call(device.open, OPENS_WITHIN)
    finally:
        owner.call(device.close, OPENS_WITHIN)
    record = DeviceRecord("device", target, address, verified=verified(type(device)))
    return {record.name: _about(record, identity)}


def _option(text: str) -> tuple[str, Any]:
    """`rate=50 Hz` as a bench file would give it."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    name, equals, value = text.partition("=")
    if not equals or not name:
        raise UsageError(f'--option: "{text}" is not name=value, for instance rate=50 Hz')
    try:
        return name, YAML(typ="safe", pure=True).load(value)
    except YAMLError as error:
        raise UsageError(f'--option {name}: "{value}" cannot be read as in a bench file') from error


PIECE = 0.1
"""How long is listened at once [s]."""
PATIENCE = 3.0
"""How long a first sample is waited for [s]."""
SHOWN = 1.0
"""While an output is held, a line so often [s]."""


@command.command(name="read")
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
    return Reading(float(series.y[-1]), 0.0, 0.0, 1) if seconds is None else series.reading()


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
    wire = f"{record.device}.{record.input}"
    click.echo(f"{record.name}  {shown(reading.mean, 6)}   raw {raw} {record.raw_unit}   {wire}")
    if data["noise"] is not None:
        noise, drift = shown(reading.noise, 2), shown(reading.drift, 2)
        click.echo(f"mean of {reading.count} samples at {data['rate']:g} Hz; noise {noise} rms, drift {drift}")
    if not data["in_range"]:
        ends = f"{shown(record.low, 6)} to {shown(record.high, 6)}"
        click.echo(f"this is outside what the channel can measure, {ends}: look at the sensor and its wire")
    if data["simulated"]:
        click.echo("SIMULATED")


@command.command(name="set")
@click.argument("bench", type=BENCH)
@click.argument("output")
@click.argument("value")
@click.option("--specimen", type=SPECIMEN, required=True, help="The specimen that is mounted; its limits hold.")
@click.option("--for", "lasting", metavar="TIME", help='Hold for so long: "10 s"; else until Ctrl-C.')
@recorded_options
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
    from pmabench.session.guided import hold_at

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
    asked = at_terminal(mounted.bench, yes=yes, there=True)
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
            means = (f"{name} {show(one.mean(), CHANNEL_QUANTITY[name], 4)}" for name, one in series.items())
            self._ui.note(f"{work.settings()}   measured {'   '.join(means)}")
        if self._paced and not work.executor.bench.realtime:
            time.sleep(PIECE)
