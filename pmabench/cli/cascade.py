"""`pmabench cascade`: muscles end to end with pressures of their own: simulate, draw, play again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.cli.common import Ui, common

if TYPE_CHECKING:
    from collections.abc import Callable

    from pmabench.model.cascade import Course
    from pmabench.model.curve import Array
    from pmabench.report.cascade_record import Result

ROWS = 25
"""Rows of the table for people."""
EXAMPLE = (
    '\b\npmabench cascade simulate paper1 --out chain\npmabench cascade replay chain --pace --at "2 s" --out again'
)


@click.group(name="cascade", epilog=EXAMPLE)
def command() -> None:
    """Muscles end to end, each with pressure steps of its own: simulate, draw, play again."""


def _output_options(function: Callable[..., Any]) -> Callable[..., Any]:
    for option in (
        click.option("--csv", "as_csv", is_flag=True, help="Comma-separated values in SI units on stdout."),
        click.option("--at", "moments", multiple=True, metavar="TIME", help="A moment of the still; repeatable."),
        click.option("--pace", is_flag=True, help="In real time, drawn in the terminal."),
    ):
        function = option(function)
    return function


@command.command(name="simulate", epilog=EXAMPLE)
@click.argument("file")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for result and drawings.")
@_output_options
@common
def simulate(ui: Ui, file: str, out: Path | None, moments: tuple[str, ...], *, pace: bool, as_csv: bool) -> int | None:
    """Simulate the chain of a cascade FILE (or the shipped paper1, unlike) as fast as possible, or paced."""
    import numpy as np

    from pmabench.files.shipped import find_file
    from pmabench.model import cascade
    from pmabench.protocol.cascade import read_cascade
    from pmabench.report.cascade_record import Head, result

    _not_both(ui, as_csv=as_csv)
    plan = read_cascade(find_file("cascade", file))
    at = _moments(moments, plan.duration, out)
    members = [muscle.member() for muscle in plan.muscles]
    times = np.arange(plan.rows) / plan.rate
    pace_kept: dict[str, float] | None = None
    if pace:
        course, elapsed = _play(
            ui, times, lambda part: cascade.simulate(members, part), [m.length for m in plan.muscles]
        )
        pace_kept = {"simulated": float(times[-1]), "elapsed": elapsed}
    else:
        course = cascade.simulate(members, times)
    head = Head(
        plan.name,
        plan.source,
        plan.load[0],
        plan.fce_eval,
        [(m.name, m.law, m.length, m.radius, m.braid_angle, m.assumed) for m in plan.muscles],
    )
    _deliver(ui, result(head, course, pace_kept), out, at, result_too=True, as_csv=as_csv)
    return None


@command.command(name="replay", epilog=EXAMPLE)
@click.argument("source", type=click.Path(path_type=Path), metavar="RESULT")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for the drawings.")
@_output_options
@common
def replay(ui: Ui, source: Path, out: Path | None, moments: tuple[str, ...], *, pace: bool, as_csv: bool) -> int | None:
    """Show or draw a RESULT (cascade.json, or the folder with it) again, without a simulation."""
    import numpy as np

    from pmabench.model.cascade import Course
    from pmabench.report.cascade_record import read_result

    _not_both(ui, as_csv=as_csv)
    found = read_result(source)
    at = _moments(moments, found.time[-1], out)
    if pace:
        t = np.array(found.time)
        P, x, F_ce = (
            np.array([getattr(m, key) for m in found.muscles]) for key in ("pressure", "displacement", "force_ce")
        )
        force = np.array(found.force)

        def part(times: Array) -> Course:
            rows = slice(*np.searchsorted(t, (times[0], times[-1] + 1e-12)).tolist())
            return Course(t[rows], P[:, rows], x[:, rows], F_ce[:, rows], force[rows])

        _play(ui, t, part, [m.length for m in found.muscles])
    _deliver(ui, found, out, at, result_too=False, as_csv=as_csv)
    return None


def _play(ui: Ui, times: Array, step: Callable[[Array], Course], lengths: list[float]) -> tuple[Course, float]:
    """The whole course in real time, and how long it took [s]."""
    import numpy as np

    from pmabench.base.clock import RealClock
    from pmabench.cli.cascade_pace import paced, show_ended, show_pace, shower
    from pmabench.model.cascade import Course

    blocks, elapsed = paced(times, step, RealClock(), shower(ui, lengths))
    show_ended(ui)
    show_pace(ui, float(times[-1]), elapsed)
    t, force = (np.concatenate([getattr(block, name) for block in blocks]) for name in ("t", "force"))
    P, x, F_ce = (np.concatenate([getattr(block, name) for block in blocks], axis=1) for name in ("P", "x", "F_ce"))
    return Course(t, P, x, F_ce, force), elapsed


def _not_both(ui: Ui, *, as_csv: bool) -> None:
    from pmabench.base.errors import UsageError

    if as_csv and ui.json:
        raise UsageError("--csv or --json, not both")


def _moments(texts: tuple[str, ...], last: float, out: Path | None) -> list[float]:
    """The moments of the still [s]; UsageError with all that is wrong."""
    from pmabench.base.errors import UsageError
    from pmabench.files.quantity import parse_quantity

    found, problems = [], []
    if texts and out is None:
        problems.append("--at chooses moments of a drawing; say with --out FOLDER where it goes")
    for text in texts:
        try:
            moment = parse_quantity(text, "time")
            if not 0 <= moment <= last:
                raise ValueError(f'"{text}" is outside the simulation, 0 to {last:g} s')
            found.append(moment)
        except ValueError as error:
            problems.append(f"--at: {error}")
    if problems:
        raise UsageError("\n".join(problems))
    return found


def _deliver(ui: Ui, found: Result, out: Path | None, moments: list[float], *, result_too: bool, as_csv: bool) -> None:
    """Write what was asked for, and show the result."""
    from pmabench.report.cascade_record import as_data, csv_text, write_result

    written = write_result(found, out) if out is not None and result_too else []
    if out is not None:
        from pmabench.report.cascade_page import write_drawings

        written += write_drawings(found, out, moments)
    data = as_data(found) | {"written": [str(path) for path in written]}

    def human() -> None:
        if as_csv:
            click.echo(csv_text(found), nl=False)
            return
        if not ui.quiet:
            _show_result(ui, found)
        for path in written:
            click.echo(str(path))

    ui.result(data, human)


def _show_result(ui: Ui, found: Result) -> None:
    """Who is in the chain, and the totals in time."""
    import numpy as np

    from pmabench.base.quantities import show
    from pmabench.cli.model_table import print_table

    convention = f"; F_ce of the printed model at {found.fce_eval}" if found.fce_eval else ""
    click.echo(f"SIMULATED: {found.name}; load {show(found.load, 'force')}{convention}\n")
    for link in found.muscles:
        most = max(link.displacement)
        click.echo(
            f"  {link.name} ({link.law}): up to {show(max(link.pressure), 'pressure')}, "
            f"{show(most, 'length', 4)}, {100 * most / link.length:.1f} %"
        )
    click.echo()
    rows = np.unique(np.linspace(0, len(found.time) - 1, ROWS).round().astype(int))
    columns = [
        {"name": name, "quantity": quantity, "values": [getattr(found, key)[row] for row in rows]}
        for name, key, quantity in (
            ("time", "time", "time"),
            ("x of the chain", "displacement", "length"),
            ("force of the chain", "force", "force"),
            ("F_ce of the chain", "force_ce", "force"),
            ("sum of F_ce", "force_ce_sum", "force"),
        )
    ]
    print_table(ui, columns, keys=1)
    click.echo(
        "\nThe force of the chain is what it pulls with if it is held where it is: that of one muscle.\n"
        "The sum of F_ce is a sum of coefficients, which paper 1 calls total F_ce; nothing feels it."
    )
