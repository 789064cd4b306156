"""`pmabench demo`: the whole main job on the mock bench, from protocol to report, anywhere."""

from __future__ import annotations

import time
from pathlib import Path

import click

from pmabench.cli.common import Ui, common, say


@click.command(name="demo")
@click.option("--out", default="pmabench-demo", show_default=True, type=click.Path(path_type=Path, file_okay=False))
@click.option("--seed", default=1, show_default=True, help="Seed of the simulated noise.")
@common
def command(ui: Ui, out: Path, seed: int) -> int | None:
    """Characterise a simulated muscle: run every shipped kind of protocol, fit, and write the report."""
    from pmabench.cli.campaign import run_campaign, severity
    from pmabench.cli.process import analyse, chains, load_runs, print_analyses, verdict_of_all, write
    from pmabench.kinds.reduce import verdicts
    from pmabench.report.document.content import content_of, write_page
    from pmabench.report.glance import glance
    from pmabench.store.analyses.made_from import key_of

    started = time.monotonic()
    outcomes = run_campaign(ui, "demo", out / "runs", operator_name="demo", yes=True, seed=seed)
    worst = max((outcome.exit_code for outcome in outcomes), key=severity)
    if worst:
        say("\n".join(f"{outcome.folder}: {outcome.status}: {outcome.why}" for outcome in outcomes))
        return worst
    recorded = sum(outcome.rows for outcome in outcomes)
    recorded_in = [outcome.folder for outcome in outcomes if outcome.folder is not None]
    key = key_of(chains(recorded_in), {})
    runs = load_runs(recorded_in)
    analyses = analyse(runs)
    folders = write(analyses, runs, out / "analyses" / runs[0].id, key)
    content = content_of(analyses, runs, title="Characterisation of a simulated MAS-20-250")
    report = write_page(content, out / "report.html")
    elapsed = time.monotonic() - started
    data = {
        "schema": "pmabench.demo/1",
        "runs": [str(outcome.folder) for outcome in outcomes],
        "folders": [str(folder) for folder in folders],
        "report": str(report),
        "rows": recorded,
        "seconds": round(elapsed, 3),
        "analyses": [analysis.to_dict() for analysis in analyses],
    }

    def human() -> None:
        if ui.verbose:
            print_analyses(ui, analyses)
        click.echo("\n".join(glance(analyses, verdict_of_all(analyses, runs, verdicts(runs, analyses)), ())))
        seconds = sum(outcome.bench_seconds for outcome in outcomes)
        ui.note(f"{seconds / 60:.0f} min at the simulated bench, {recorded:,} rows, in {elapsed:.1f} s")
        click.echo(f"report  {report}")
        click.echo("next    pmabench init our-lab    the same for a bench of your own")

    ui.result(data, human, [str(report)])
    return None
