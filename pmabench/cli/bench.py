"""`pmabench bench`: its card to hang at the rig, and what its devices answer (`bench_probe`, `bench_values`)."""

from __future__ import annotations

import datetime
from dataclasses import asdict
from pathlib import Path

import click

from pmabench.cli.bench_probe import probe
from pmabench.cli.bench_values import read, set_
from pmabench.cli.common import Ui, common
from pmabench.cli.names import BENCH, SPECIMEN
from pmabench.files.shipped import find_file


@click.group(name="bench")
def command() -> None:
    """A bench: its card for people at the rig; ask its devices, read one channel, set one output."""


command.add_command(probe)
command.add_command(read)
command.add_command(set_)


@command.command(name="card")
@click.argument("bench", type=BENCH)
@click.option(
    "--specimen", type=SPECIMEN, help="Specimen file, or the name of a shipped one: its limits are counted in."
)
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False), help="The HTML file.")
@common
def card(ui: Ui, bench: str, specimen: str | None, output: Path) -> int | None:
    """Write the card of BENCH: limits, what vents, what happens when something fails, wiring; one A4 page."""
    from pmabench.bench.card import make_card
    from pmabench.bench.compile import mount, mount_alone
    from pmabench.report.pages.bench_card import write_card

    path = find_file("bench", bench)
    mounted = mount(path, find_file("specimen", specimen)) if specimen is not None else mount_alone(path)
    made = make_card(mounted, datetime.date.today().isoformat())
    write_card(asdict(made), output)
    ui.result({"schema": "pmabench.bench-card/1", "path": str(output)}, lambda: click.echo(str(output)))
    return None
