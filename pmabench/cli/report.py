"""`pmabench report`: runs or analyses to one self-contained HTML file, and to a PDF and a workbook."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from pmabench.base.errors import UsageError
from pmabench.cli.common import Ui, common


@click.command(name="report")
@click.argument("sources", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="RUN-OR-ANALYSIS...")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path, dir_okay=False), help="The HTML file.")
@click.option(
    "--pdf", type=click.Path(path_type=Path, dir_okay=False), help="Also as a tagged PDF; needs the extra pdf."
)
@click.option(
    "--xlsx", type=click.Path(path_type=Path, dir_okay=False), help="Also as a workbook; needs the extra xlsx."
)
@click.option(
    "--overlay", "overlays", multiple=True, metavar="FILE.csv[:LABEL]", help="Published points for the figures."
)
@click.option("--title", help="Title of the report.")
@click.option("--laboratory", default="", metavar="TEXT", help="Name and address of the laboratory.")
@click.option("--customer", default="", metavar="TEXT", help="For whom it was tested.")
@click.option("--authorised-by", default="", metavar="TEXT", help="Who authorises the report.")
@click.option(
    "--issued", default="", metavar="DATE", help="Date of issue as it is printed; today's is not put in by itself."
)
@common
def command(
    ui: Ui,
    sources: tuple[Path, ...],
    output: Path,
    pdf: Path | None,
    xlsx: Path | None,
    overlays: tuple[str, ...],
    title: str | None,
    **issuer: str,
) -> int | None:
    """Write the characterisation report of runs (processed now), of analysis folders, or of folders of them."""
    from pmabench.cli.process import analyse, apart, load_runs, since_lines, without_analyses
    from pmabench.cli.report_overlays import read_overlays
    from pmabench.report.document.checklist import Issuer
    from pmabench.report.document.content import content_of, write_page
    from pmabench.store.analyses.folder import read_analysis, runs_of

    for path in (path for path in (output, pdf, xlsx) if path is not None and path.is_fifo()):
        raise UsageError(f"{path} is a pipe; give the name of a file")
    published = read_overlays(overlays)
    folders, others = apart(sources)
    runs = load_runs(without_analyses(ui, others) if others else [])
    analyses = [read_analysis(folder) for folder in folders]
    seen: dict[tuple[str, tuple[str, ...]], Path] = {}
    for folder, analysis in zip(folders, analyses, strict=True):
        other = seen.setdefault((analysis.kind, analysis.runs), folder)
        if other != folder:
            raise UsageError(f"{other} and {folder} are analyses of the same runs: give one of the two")
    for folder in folders:
        runs += load_runs(runs_of(folder))
    analyses += analyse([run for run in runs if not any(run.id in analysis.runs for analysis in analyses)])
    for line in since_lines(runs):
        ui.note(line)
    content = content_of(analyses, runs, title=title, published=published, issuer=Issuer(**issuer))
    written = {"path": str(write_page(content, output))}
    if pdf is not None:
        from pmabench.report.document.pdf import write_pdf

        written["pdf"] = str(write_pdf(content, pdf))
    if xlsx is not None:
        from pmabench.report.document.workbook import write_workbook

        written["xlsx"] = str(write_workbook(content, analyses, xlsx))
    data: dict[str, Any] = {"schema": "pmabench.report/1", **written}
    data["since"] = {run.id: run.since.as_data() for run in runs if run.since.sentences}
    ui.result(data, lambda: click.echo("\n".join(written.values())))
    return None
