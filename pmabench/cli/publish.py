"""`pmabench publish`: analyses with their records as a package for a repository of research data."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from pmabench.base.errors import UsageError
from pmabench.cli.common import Ui, common
from pmabench.cli.names import PATH, RunFolder
from pmabench.report.publishing.about import LICENCES, About, Author, Place


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
def command(
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
    from pmabench.cli.process import apart, stored, without_analyses
    from pmabench.cli.report import analysed
    from pmabench.plotting.svg import import_without_3d
    from pmabench.report.document.content import content_of, page_of
    from pmabench.report.document.provenance import operators
    from pmabench.report.publishing.package import publish
    from pmabench.store.folder import files_of

    import_without_3d()
    folders, others = apart(sources)
    given = without_analyses(ui, others) if others else []
    analyses, runs = analysed(ui, folders, folders if folders or fresh else stored(ui, given), given)
    publish(analyses, runs, page_of(content_of(analyses, runs, title=about.title or None)), about, output)
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
