"""`pmabench export` and `publish`: runs and coefficients as files of other programs, or as one publication."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from pmabench.base.errors import UsageError
from pmabench.cli.common import Ui, common
from pmabench.cli.names import PATH, RunFolder
from pmabench.report.publishing.about import LICENCES, About, Author, Place

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
    from pmabench.cli.sources import Sources, apart
    from pmabench.notebook import Results, open_run
    from pmabench.report.files.export import export_results, export_run

    if output.is_fifo():
        raise UsageError(f"{output} is a pipe; give the name of a file or folder")
    folder = form in ("csv", "parquet")
    if folder and output.exists() and not output.is_dir():
        raise UsageError(f"{output} is a file; --format {form} writes a folder")
    if not folder and output.is_dir():
        raise UsageError(f"{output} is a folder; --format {form} writes one file")
    others = apart(sources)[1] if form in SAMPLES else []
    if others:
        if len(sources) > 1:
            raise UsageError(f"--format {form} of runs takes one run at a time; of analysis folders any number")
        paths = export_run(open_run(others[0]), form, output)
    else:
        analyses, runs = Sources.of(ui, sources, fresh=fresh).analysed(ui, once=False)
        found = Results(tuple(analyses), tuple(runs))
        paths = export_results(found, form, output)
    written = [str(path) for path in paths]
    data = {"schema": "pmabench.export/1", "format": form, "written": written}
    ui.result(data, lambda: click.echo("\n".join(written)), written)


@click.command(name="publish")
@click.argument("sources", nargs=-1, required=True, type=RunFolder(), metavar="RUN-OR-ANALYSIS...")
@click.option("-o", "--output", required=True, type=PATH, help="A new folder, or NAME.zip.")
@click.option(
    "--author", "authors", multiple=True, required=True, metavar="TEXT",
    help='"Family, Given; ORCID; Affiliation https://address", as far as known; once for each author.',
)  # fmt: skip
@click.option("--licence", required=True, type=click.Choice(list(LICENCES)), help="How others may use the data.")
@click.option("--publisher", required=True, metavar="TEXT", help='Repository or laboratory: "Name https://address".')
@click.option("--title", default="", help="Made of the specimen if not given.")
@click.option("--doi", default="", help="Where the repository has reserved one.")
@click.option("--date", "published", default="", metavar="DATE", help="Of publication, 2026-11-28; today if not given.")
@click.option("--fresh", is_flag=True, help="Compute anew what `process` stored.")
@common
def publish(
    ui: Ui,
    sources: tuple[Path, ...],
    output: Path,
    authors: tuple[str, ...],
    published: str,
    fresh: bool,
    publisher: str,
    **facts: str,
) -> None:
    """Put runs, their analyses and the report together for a repository of research data.

    Sealed records, coefficients, report, README and checksums, described as RO-Crate, DataCite, Data Package and
    CITATION.cff. Runs are processed first, unless `process` did that and nothing has changed since.
    """
    if output.exists():
        raise UsageError(f"{output} is there already: a publication is not mixed with other files; give a new name")
    today = datetime.now(UTC).date().isoformat()
    people, place = tuple(map(Author.read, authors)), Place.read(publisher)
    about = About(people, publisher=place, published=published or today, **facts)
    ui.begin("putting the publication together")
    from pmabench.cli.sources import Sources
    from pmabench.kinds.reduce import of_one_specimen
    from pmabench.report.document.content import content_of, page_of
    from pmabench.report.document.provenance import operators
    from pmabench.report.publishing.package import publish
    from pmabench.store.folder import files_of

    analyses, runs = Sources.of(ui, sources, fresh=fresh).analysed(ui)
    page = page_of(content_of(analyses, of_one_specimen(runs), title=about.title or None))
    publish(analyses, runs, page, about, output)
    names = operators(runs)
    files = len(list(files_of(output))) if output.is_dir() else None
    data: dict[str, Any] = {"schema": "pmabench.publish/1", "path": str(output), "licence": about.licence}
    data |= {"runs": [run.id for run in runs], "doi": about.doi or None, "operators": names, "files": files}

    def human() -> None:
        click.echo(str(output))
        if names:
            click.echo(f"!  the records name their operators ({names}) and places of files: ask before you publish")
        if not about.doi:
            click.echo("!  no DOI yet: reserve one at the repository and give --doi, or let it add one")

    ui.result(data, human, [str(output)])
