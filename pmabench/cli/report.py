"""`pmabench report`: runs or analyses to one self-contained HTML file."""

from __future__ import annotations

from pathlib import Path

import click

from pmabench.base.errors import UsageError
from pmabench.cli.common import Ui, common


@click.command(name="report")
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="RUN-OR-ANALYSIS...")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False), help="The HTML file.")
@click.option(
    "--overlay", "overlays", multiple=True, metavar="FILE.csv[:LABEL]", help="Published points for the figures."
)
@click.option("--title", help="Title of the report.")
@click.option("--laboratory", default="", metavar="TEXT", help="Name and address of the laboratory.")
@click.option("--customer", default="", metavar="TEXT", help="For whom it was tested.")
@click.option("--authorised-by", default="", metavar="TEXT", help="Who authorises the report.")
@click.option("--issued", default="", metavar="DATE", help="Date of issue; today's is not put in by itself.")
@common
def command(
    ui: Ui,
    sources: tuple[Path, ...],
    output: Path,
    overlays: tuple[str, ...],
    title: str | None,
    **told: str,
) -> int | None:
    """Write the characterisation report of runs (processed now) or of analysis folders."""
    from pmabench.cli.process import analyse, load_runs, without_analyses
    from pmabench.cli.report_overlays import read_overlays
    from pmabench.report.analysis_folder import read_analysis, runs_of
    from pmabench.report.checklist import Issuer
    from pmabench.report.html import write_report

    if output.is_fifo():
        raise UsageError(f"{output} is a pipe; give the name of a file")
    published = read_overlays(overlays)
    folders = [source for source in sources if (source / "analysis.json").is_file()]
    others = [source for source in sources if source not in folders]
    runs = load_runs(without_analyses(ui, others) if others else [])
    analyses = [read_analysis(folder) for folder in folders]
    for folder in folders:
        runs += load_runs(runs_of(folder))
    analyses += analyse([run for run in runs if not any(run.id in analysis.runs for analysis in analyses)])
    path = write_report(analyses, runs, output, title=title, published=published, issuer=Issuer(**told))
    ui.result({"schema": "pmabench.report/1", "path": str(path)}, lambda: click.echo(str(path)))
    return None
