"""`pmabench model cascade`: muscles end to end with pressures of their own: simulate, draw, play again in real time."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pmabench.base.clock import Clock, RealClock
from pmabench.base.quantities import show
from pmabench.cli.common import Group, Problems, Ui, common, fields, rewrite, with_options
from pmabench.cli.names import FOLDER, PATH
from pmabench.files.shipped import find_file

if TYPE_CHECKING:
    from pmabench.model.cascade import Course
    from pmabench.model.curve import Array
    from pmabench.report.cascade_record import Result

ROWS = 25
"""Rows of the table for people."""
EXAMPLE = (
    "\b\npmabench model cascade simulate paper1 --out chain\n"
    'pmabench model cascade replay chain --pace --at "2 s" --out again'
)


@click.group(name="cascade", epilog=EXAMPLE, cls=Group)
def command() -> None:
    """Muscles end to end, each with its pressure steps: simulate, draw, play again."""


_output_options = with_options(
    click.option("--csv", "as_csv", is_flag=True, help="Comma-separated values in SI units on stdout."),
    click.option("--at", "moments", multiple=True, metavar="TIME", help="A moment of the still; repeatable."),
    click.option("--pace", is_flag=True, help="In real time, drawn in the terminal."),
)


@command.command(name="simulate", epilog=EXAMPLE)
@click.argument("file")
@click.option("--out", type=FOLDER, help="Folder for result and drawings.")
@_output_options
@common
def simulate(ui: Ui, file: str, out: Path | None, moments: tuple[str, ...], *, pace: bool, as_csv: bool) -> None:
    """Simulate the chain of a cascade FILE (or the shipped paper1, unlike) as fast as possible, or paced."""
    import numpy as np

    from pmabench.model import cascade
    from pmabench.protocol.cascade import read_cascade
    from pmabench.report.cascade_record import result

    plan = read_cascade(find_file("cascade", file))
    at = _moments(moments, plan.duration, out)
    members = [muscle.member() for muscle in plan.muscles]
    times = np.arange(plan.rows) / plan.rate
    pace_kept: dict[str, float] | None = None
    if pace:
        course, elapsed = _play(ui, times, lambda part: cascade.simulate(members, part))
        pace_kept = {"simulated": float(times[-1]), "elapsed": elapsed}
    else:
        course = cascade.simulate(members, times)
    about = fields(plan, "name", "source", "fce_eval") | {"load": plan.load[0]}
    muscles = [fields(m, "name", "law", "length", "radius", "braid_angle") for m in plan.muscles]
    _deliver(ui, result(about, muscles, course, pace_kept), out, at, result_too=True, as_csv=as_csv)


@command.command(name="replay", epilog=EXAMPLE)
@click.argument("source", type=PATH, metavar="RESULT")
@click.option("--out", type=FOLDER, help="Folder for the drawings.")
@_output_options
@common
def replay(ui: Ui, source: Path, out: Path | None, moments: tuple[str, ...], *, pace: bool, as_csv: bool) -> None:
    """Show or draw a RESULT (cascade.json, or the folder with it) again, without a simulation."""
    import numpy as np

    from pmabench.model.cascade import Course
    from pmabench.report.cascade_record import read_result

    found = read_result(source)
    at = _moments(moments, found.time[-1], out)
    if pace:
        t = np.array(found.time)
        names = ("pressure", "displacement", "force_ce")
        each = (np.array([getattr(m, name) for m in found.muscles]) for name in names)
        whole = [t, *each, np.array(found.force)]

        def part(times: Array) -> Course:
            rows = slice(*np.searchsorted(t, (times[0], times[-1] + 1e-12)).tolist())
            return Course(*(values[..., rows] for values in whole))

        _play(ui, t, part)
    _deliver(ui, found, out, at, result_too=False, as_csv=as_csv)


def _play(ui: Ui, times: Array, step: Callable[[Array], Course]) -> tuple[Course, float]:
    """Simulate or replay in real time; the whole course, and how long it took [s]."""
    import numpy as np

    from pmabench.model.cascade import Course

    live = sys.stderr.isatty() and not ui.quiet

    def show(t: float, x: float) -> None:
        if live:
            rewrite(f"{t:8.2f} s  {1e3 * x:7.2f} mm")

    blocks, elapsed = paced(times, step, RealClock(), show)
    if live:
        rewrite()
    show_pace(ui, float(times[-1]), elapsed)
    parts = zip(*(vars(block).values() for block in blocks), strict=True)
    return Course(*(np.concatenate(part, axis=-1) for part in parts)), elapsed


def _moments(texts: tuple[str, ...], last: float, out: Path | None) -> list[float]:
    """The moments of the still [s]; UsageError with all that is wrong."""
    from pmabench.files.quantity import parse_quantity

    found, problems = [], Problems()
    if texts and out is None:
        problems.append("--at chooses moments of a drawing; say with --out FOLDER where it goes")
    for text in texts:
        with problems.of("--at"):
            moment = parse_quantity(text, "time")
            if not 0 <= moment <= last:
                raise ValueError(f'"{text}" is outside the simulation, 0 to {last:g} s')
            found.append(moment)
    problems.refuse()
    return found


def _deliver(ui: Ui, found: Result, out: Path | None, moments: list[float], *, result_too: bool, as_csv: bool) -> None:
    """Write the files that were requested, and show the result."""
    from pmabench.report.cascade_record import csv_text, write_result

    written = write_result(found, out) if out is not None and result_too else []
    if out is not None:
        from pmabench.report.cascade_page import write_drawings

        written += write_drawings(found, out, moments)
    data = found.model_dump(by_alias=True) | {"written": [str(path) for path in written]}

    def human() -> None:
        if as_csv:
            click.echo(csv_text(found), nl=False)
            return
        if not ui.quiet:
            _show_result(ui, found)
        click.echo("".join(f"{path}\n" for path in written), nl=False)

    ui.result(data, human)


def _show_result(ui: Ui, found: Result) -> None:
    """Print the muscles of the chain, and a table of the totals over time."""
    import numpy as np

    from pmabench.cli.model_inputs import column_of, print_table

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
    shown = (
        ("time", "time", found.time),
        ("x of the chain", "length", found.displacement),
        ("force of the chain", "force", found.force),
        ("F_ce of the chain", "force", found.force_ce),
        ("sum of F_ce", "force", found.force_ce_sum),
    )
    print_table(
        ui, [column_of(name, quantity, [values[row] for row in rows]) for name, quantity, values in shown], keys=1
    )
    click.echo(
        "\nThe force of the chain is what it pulls with if it is held where it is: that of one muscle.\n"
        "The sum of F_ce is a sum of coefficients, which paper 1 calls total F_ce; nothing feels it."
    )


BLOCK = 0.05
"""Time of one block [s]."""
CLOSE = 0.02
"""How far elapsed and simulated time may lie apart."""
Show = Callable[[float, float], None]
"""Takes the time [s] and the contraction of the chain [m]."""


def paced(times: Array, step: Callable[[Array], Course], clock: Clock, show: Show) -> tuple[list[Course], float]:
    """Take `times` [s] block by block, each ending no earlier than its moment; the blocks and the seconds elapsed."""
    import numpy as np

    begin = clock.now()
    blocks: list[Course] = []
    edges = np.arange(1, int(times[-1] / BLOCK) + 2) * BLOCK + 1e-9
    for part in np.split(times, np.searchsorted(times, edges, side="right")):
        if len(part) == 0:
            continue
        course = step(part)
        blocks.append(course)
        clock.wait_until(begin + float(part[-1]))
        show(float(part[-1]), float(course.x[:, -1].sum()))
    return blocks, clock.now() - begin


def show_pace(ui: Ui, simulated: float, elapsed: float) -> None:
    """Say how well the pace was kept."""
    apart = elapsed / simulated - 1
    if abs(apart) <= CLOSE:
        ui.note(f"{simulated:.3f} s in {elapsed:.3f} s ({100 * apart:+.2f} %)")
        return
    advice = "this computer does not keep up; take a lower sample_rate, or leave --pace"
    ui.note(f"{simulated:.3f} s took {elapsed:.3f} s ({100 * apart:+.1f} %): {advice}")
