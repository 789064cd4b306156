"""`pmabench demo`: the whole main job on the mock bench, from protocol to report, anywhere."""

from __future__ import annotations

import time
from pathlib import Path

import click

from pmabench.cli.common import Ui, common, say
from pmabench.cli.names import FOLDER


@click.command(name="demo")
@click.option("--out", default="pmabench-demo", show_default=True, type=FOLDER)
@click.option("--seed", default=1, show_default=True, help="Seed of the simulated noise.")
@common
def command(ui: Ui, out: Path, seed: int) -> int | None:
    """Characterise a simulated muscle: run every shipped kind of protocol, fit, and write the report."""
    from pmabench.cli.campaign import run_campaign, severity
    from pmabench.cli.process import print_analyses
    from pmabench.cli.report import characterise

    started = time.monotonic()
    outcomes = run_campaign(ui, "demo", out / "runs", operator_name="demo", yes=True, seed=seed)
    worst = max((outcome.exit_code for outcome in outcomes), key=severity)
    if worst:
        say("\n".join(f"{outcome.folder}: {outcome.status}: {outcome.why}" for outcome in outcomes))
        return worst
    recorded = sum(outcome.rows for outcome in outcomes)
    recorded_in = [outcome.folder for outcome in outcomes if outcome.folder is not None]
    place = out / "analyses" / recorded_in[0].name
    title = "Characterisation of a simulated MAS-20-250"
    found = characterise(recorded_in, place, out / "report.html", title)
    elapsed = time.monotonic() - started
    data = {
        "schema": "pmabench.demo/1",
        "runs": [str(outcome.folder) for outcome in outcomes],
        "folders": [str(folder) for folder in found.folders],
        "report": str(found.report),
        "rows": recorded,
        "seconds": round(elapsed, 3),
        "analyses": [analysis.to_dict() for analysis in found.analyses],
    }

    def human() -> None:
        if ui.verbose:
            print_analyses(ui, found.analyses)
        click.echo("\n".join(found.lines()))
        seconds = sum(outcome.bench_seconds for outcome in outcomes)
        ui.note(f"{seconds / 60:.0f} min at the simulated bench, {recorded:,} rows, in {elapsed:.1f} s")
        click.echo("next    pmabench init our-lab    the same for a bench of your own")

    ui.result(data, human, [str(found.report)])
    return None
