"""`pmabench calibrate`: guided calibration of a channel or of the regulator; writes a new calibration file."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import asdict
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError
from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.cli.common import Ui, common, read_quantity, recorded_options, say
from pmabench.cli.names import BENCH, FOLDER, SPECIMEN
from pmabench.cli.outcome import AtLines, outcome_json, print_outcome, progress_line
from pmabench.engine.operator import ConfirmedBeforehand, Nobody
from pmabench.report.terminal import print_texts

if TYPE_CHECKING:
    from pmabench.bench.compile import Mounted
    from pmabench.engine.operator import Operator
    from pmabench.session.calibration import Calibrated, Read, Request


@click.command(name="calibrate")
@click.argument("channel")
@click.option("--bench", type=BENCH, required=True, help="Bench file, or the name of a shipped one.")
@click.option(
    "--specimen",
    type=SPECIMEN,
    required=True,
    help="Specimen file, or the name of a shipped one: its limits hold here too.",
)
@click.option("--reference", required=True, metavar="TEXT", help="What it is compared with, and its certificate.")
@click.option("--reference-uncertainty", required=True, metavar="QUANTITY", help="Of the reference, k = 2: 0.5 N.")
@click.option("--points", required=True, metavar="LIST", help='Reference points: "0 N, 58.86 N, 107.91 N".')
@click.option("--cycles", default=2, show_default=True, help="How often up and down.")
@click.option("--hold", default="0 kPa", metavar="PRESSURE", help="Pressure that lifts loads off their support.")
@click.option("--into", default="calibrations", show_default=True, type=FOLDER, help="Where the file goes.")
@click.option("--valid-until", type=click.DateTime(["%Y-%m-%d"]), help="Last day of the calibration.")
@recorded_options
@click.option(
    "--yes", is_flag=True, help="Simulated benches: the nominal value counts as the reading of the reference."
)
@common
def command(
    ui: Ui, channel: str, bench: str, specimen: str, into: Path, valid_until: datetime | None, *, yes: bool, **how: Any
) -> int:
    """Calibrate CHANNEL (force, pressure, displacement, angle; pressure_command: the regulator) by points."""
    from pmabench.cli.prepare import mounted_of
    from pmabench.session.calibration import check, not_shown, uncovered

    out, operator = how.pop("out"), how.pop("operator")
    request = _request(channel, yes=yes, **how)
    mounted = mounted_of(bench, specimen)
    check(mounted, request)
    for warning in (*uncovered(mounted, request), *not_shown(request)):
        ui.note(f"warning: {warning}")
    done = _run(ui, mounted, request, out, operator, yes=yes)
    for warning in done.warnings:
        ui.note(f"warning: {warning}")
    path = None
    if done.fit is not None and done.outcome.exit_code == 0 and done.outcome.folder is not None:
        path = _write(mounted, request, done, into, valid_until.date() if valid_until else None)
    _show_result(ui, mounted, request, done, path)
    return done.outcome.exit_code


def _request(
    channel: str, reference: str, reference_uncertainty: str, points: str, cycles: int, hold: str, *, yes: bool
) -> Request:
    """What was typed, in SI."""
    from pmabench.session.calibration import Request

    quantity = CHANNEL_QUANTITY.get(channel, "force")
    places = tuple(read_quantity("--points", text, quantity) for text in points.split(","))
    unsure = read_quantity("--reference-uncertainty", reference_uncertainty, quantity)
    held = read_quantity("--hold", hold, "pressure")
    if unsure < 0:
        raise UsageError("--reference-uncertainty: an uncertainty is not below zero")
    return Request(channel, places, reference, unsure, cycles, nominal=yes, hold=held)


def _reading(typed: Callable[[], str], quantity: str, nominal: float, far: float) -> float:
    """What was typed [SI]; asked until it is a quantity, and again where it is `far` from the nominal value."""
    before = nominal
    while True:
        try:
            value = read_quantity("reading", typed(), quantity)
        except UsageError as error:
            say(str(error))
            continue
        if abs(value - nominal) <= far or value == before:
            return value
        before = value
        say(f"{show(value, quantity)} is far from {show(nominal, quantity)}: is the unit right? Type it again if it is")


FAR = 0.5
"""Difference of a reading from its nominal value, as a share of the largest one, from which on it is asked again."""


def _run(ui: Ui, mounted: Mounted, request: Request, out: Path, operator: str, *, yes: bool) -> Calibrated:
    from pmabench.session.calibration import calibrate

    lines = AtLines(realtime=mounted.bench.realtime)
    quantity = CHANNEL_QUANTITY[request.channel]
    far = FAR * max(abs(point) for point in request.points)

    def typed(text: str, nominal: float, wait: Callable[[], None]) -> float:
        return _reading(lambda: lines.line(f"{text} ", wait), quantity, nominal, far)

    def nobody(text: str, _nominal: float, _wait: Callable[[], None]) -> float:
        raise UsageError(f"a reading is needed ({text}) and there is no terminal; --yes is for simulated benches")

    answers: tuple[Operator, Read] = (lines, typed) if sys.stdin.isatty() else (Nobody(), nobody)
    if yes:
        answers = ConfirmedBeforehand(), lambda _text, nominal, _wait: nominal
    with progress_line(ui, "calibration") as progress:
        return calibrate(mounted, request, *answers, out, operator_name=operator, progress=progress)


def _write(mounted: Mounted, request: Request, done: Calibrated, into: Path, until: date | None) -> Path:
    from pmabench.session.calibration_line import write_calibration

    assert done.fit is not None and done.outcome.folder is not None  # noqa: S101, PT018  (looked at before)
    read = " (not read: nominal values, --yes)" if request.nominal and request.channel != "pressure_command" else ""
    lag = next((c.calibration.sensor_lag for c in mounted.bench.channels if c.name == request.channel), 0.0)
    return write_calibration(
        into,
        request.channel,
        CHANNEL_QUANTITY[request.channel],
        done.raw_unit,
        done.fit,
        reference=request.reference + read,
        run=done.outcome.folder.name,
        today=date.today(),
        valid_until=until,
        sensor_lag=lag,
    )


def _show_result(ui: Ui, mounted: Mounted, request: Request, done: Calibrated, path: Path | None) -> None:
    from pmabench.session.calibration import REGULATOR, uncovered
    from pmabench.session.calibration_line import budget

    quantity = CHANNEL_QUANTITY[request.channel]
    data: dict[str, Any] = {
        "schema": "pmabench.calibrated/1",
        "channel": request.channel,
        "file": str(path) if path is not None else None,
        "fit": asdict(done.fit) if done.fit is not None else None,
        "warnings": list(done.warnings),
        "outcome": outcome_json(done.outcome),
    }

    def human() -> None:
        if done.fit is not None:
            rows = [[name, value] for name, value in budget(done.fit, quantity, done.raw_unit)]
            print_texts(ui.console(), [f"calibration of {request.channel}", ""], rows)
        print_outcome(done.outcome)
        if path is None:
            return
        click.echo(str(path))
        if request.channel == REGULATOR and done.fit is not None:
            ends = [done.fit.points[0][0], done.fit.points[-1][0]]
            pairs = [f"[{raw:.8g} {done.raw_unit}, {done.fit.scale.to_si(raw) / 1e3:.8g} kPa]" for raw in ends]
            click.echo(f"in the bench file, for the output pressure: scale: [{', '.join(pairs)}]")
        else:
            click.echo(f'in the bench file, for the channel {request.channel}: "calibration: {path.stem}"')
        if done.fit is not None and done.fit.residual is None:
            click.echo("first put its expanded_uncertainty into the file, in place of ??: two points do not show it")
        click.echo("".join(f"first: {text}\n" for text in uncovered(mounted, request)), nl=False)

    ui.result(data, human, [str(path)] if path is not None else [])
