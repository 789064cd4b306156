"""`pmabench export`: a run or its coefficients as files of other programs."""

from __future__ import annotations

from pathlib import Path

import click

from pmabench.base.errors import UsageError
from pmabench.cli.common import Ui, common
from pmabench.cli.names import PATH, RunFolder

FORMATS = ("csv", "parquet", "mat", "latex", "json", "python-control", "mujoco")
SAMPLES = ("csv", "parquet", "mat")
"""Formats in which a run's own samples are given out; for the others it is processed."""


@click.command(name="export")
@click.argument("sources", nargs=-1, required=True, type=RunFolder(), metavar="RUN-OR-ANALYSIS...")
@click.option("--format", "form", required=True, type=click.Choice(FORMATS), help="Kind of file.")
@click.option("-o", "--output", required=True, type=PATH, help="Folder for csv and parquet, else the file.")
@click.option("--fresh", is_flag=True, help="Compute anew what `process` stored and nothing has changed.")
@common
def command(ui: Ui, sources: tuple[Path, ...], form: str, output: Path, fresh: bool) -> None:
    """Write samples and trials of one RUN (csv, parquet, mat), or the coefficients of analyses (all formats).

    A folder of analyses means all in it. For latex, json, python-control and mujoco runs are processed first,
    unless `process` did that and nothing has changed since. Units are in the heads of columns.
    """
    from pmabench.cli.process import apart
    from pmabench.notebook import Results, open_analysis, open_run
    from pmabench.report.files.export import export_results, export_run

    if output.is_fifo():
        raise UsageError(f"{output} is a pipe; give the name of a file or folder")
    folder = form in ("csv", "parquet")
    if folder and output.exists() and not output.is_dir():
        raise UsageError(f"{output} is a file; --format {form} writes a folder")
    if not folder and output.is_dir():
        raise UsageError(f"{output} is a folder; --format {form} writes one file")
    folders, others = apart(sources)
    if form in SAMPLES and others:
        if len(sources) > 1:
            raise UsageError(f"--format {form} of runs takes one run at a time; of analysis folders any number")
        paths = export_run(open_run(others[0]), form, output)
    else:
        from pmabench.cli.process import analyse, load_runs, read_all, stored, without_analyses

        found = open_analysis(*folders) if folders else Results((), ())
        if others:
            given = without_analyses(ui, others)
            before = read_all(ui, [] if fresh else stored(ui, given))
            runs = load_runs(given)
            found = Results((*found.analyses, *(before or analyse(runs))), (*found.runs, *runs))
        paths = export_results(found, form, output)
    written = [str(path) for path in paths]
    data = {"schema": "pmabench.export/1", "format": form, "written": written}
    ui.result(data, lambda: click.echo("\n".join(written)), written)
