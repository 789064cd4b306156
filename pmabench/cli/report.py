"""`pmabench report`: runs or analyses to one self-contained HTML file, and to a PDF and a workbook.

With `--overlay FILE.csv[:LABEL]` published tables, read with their units, for the figures that they match.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import InvalidFile, Problem, UsageError, invalid
from pmabench.base.quantities import QUANTITIES
from pmabench.cli.common import Ui, common, no_pipes
from pmabench.cli.names import FILE, HTML, PATH, RunFolder, next_lines

if TYPE_CHECKING:
    from pmabench.cli.process import Processed
    from pmabench.files.table import Column
    from pmabench.report.document.content import Content
    from pmabench.report.overlays import Published
    from pmabench.report.writing import KeptPage
    from pmabench.store.analyses.results import Analysis
    from pmabench.store.records import RunData


@click.command(name="report")
@click.argument("sources", nargs=-1, required=True, type=RunFolder(), metavar="RUN-OR-ANALYSIS...")
@click.option("-o", "--output", required=True, type=HTML, help="The HTML file.")
@click.option("--pdf", type=FILE, help="Also as a tagged PDF; needs the extra pdf.")
@click.option("--xlsx", type=FILE, help="Also as a workbook; needs the extra xlsx.")
@click.option("--figures", type=PATH, metavar="DIR", help="Also each figure as an SVG file, with captions.txt.")
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
@click.option("--long", is_flag=True, help="Open the appendices, so that they are printed, too.")
@click.option("--fresh", is_flag=True, help="Compute anew what `process` or `report` stored.")
@common
def command(
    ui: Ui,
    sources: tuple[Path, ...],
    output: Path,
    pdf: Path | None,
    xlsx: Path | None,
    figures: Path | None,
    overlays: tuple[str, ...],
    title: str | None,
    long: bool,
    fresh: bool,
    **issuer: str,
) -> None:
    """Write the characterisation report of runs, of analysis folders, or of folders of them.

    Two pages that print on A4, then appendices that fold out, in one file that needs nothing else.
    Runs are processed now, unless `process` did that and nothing has changed since.
    """
    from pmabench.cli.sources import Sources, chains
    from pmabench.report.writing import keep, kept, page_key, write_file
    from pmabench.store.analyses.folder import runs_of
    from pmabench.store.since import as_sealed

    no_pipes(output, pdf, xlsx)
    published = read_overlays(overlays)
    known = Sources.of(ui, sources, fresh=fresh)
    folders, given, used = known.folders, known.given, known.used
    key = ""
    if used and not (published or (folders and given)):
        behind = chains(given or [run for folder in folders for run in runs_of(folder)])
        about = {"sources": [str(path) for path in sources], "title": title, "long": long, **issuer}
        key = page_key(used, behind, about) if all(as_sealed(run) for run in behind) else ""
    page = None if fresh or pdf or xlsx or figures or not key else kept(used[0].parent, key)
    if page is not None:
        for line in page.remarks:
            ui.note(line)
        written = {"path": str(write_file(output, page.text, "the report"))}
    else:
        ui.begin("making the report")
        from pmabench.report.document.content import write_figures
        from pmabench.report.document.deviations import Issuer

        said: dict[str, Any] = {"title": title, "published": published, "issuer": Issuer(**issuer)}
        content, written, page = _written(ui, *known.analysed(ui), output, pdf, xlsx, long=long, **said)
        if figures is not None:
            written["figures"] = str(write_figures(content, figures))
        if key:
            keep(used[0].parent, key, page)
    data: dict[str, Any] = {"schema": "pmabench.report/1", **written, "since": dict(page.since)}
    ui.result(data, lambda: click.echo("\n".join(written.values())))


def _written(
    ui: Ui, analyses: list[Analysis], runs: list[RunData], output: Path, pdf: Path | None, xlsx: Path | None,
    *, long: bool, **about: Any,
) -> tuple[Content, dict[str, str], KeptPage]:  # fmt: skip
    """Write the report in each format that is wanted, `about` as in `content_of`: its content, files and page."""
    from pmabench.cli.sources import since_lines
    from pmabench.kinds.reduce import of_one_specimen
    from pmabench.report.document.content import content_of, page_of
    from pmabench.report.many import added_to
    from pmabench.report.writing import KeptPage, write_file

    page = KeptPage("", added_to(runs)["since"], since_lines(runs))
    for line in page.remarks:
        ui.note(line)
    content = content_of(analyses, of_one_specimen(runs), **about)
    page = replace(page, text=page_of(content, long=long))
    written = {"path": str(write_file(output, page.text, "the report"))}
    if pdf is not None:
        from pmabench.report.document.formats import write_pdf

        written["pdf"] = str(write_pdf(content, pdf))
    if xlsx is not None:
        from pmabench.report.document.formats import write_workbook

        written["xlsx"] = str(write_workbook(content, analyses, xlsx))
    return content, written, page


def characterise(given: Sequence[Path], place: Path, report: Path, title: str | None = None) -> Processed:
    """Process runs together into `place`, and write the page `report`."""
    from pmabench.cli.process import processed
    from pmabench.report.document.content import content_of, write_page

    found = processed(given, place)
    write_page(content_of(found.analyses, found.runs, title=title), report)
    return found


def characterised_lines(found: Processed, report: Path) -> list[str]:
    """The results at a glance, where the report is, and what to type where they are not accepted."""
    then = found.described_by()
    return [*found.glance(), f"report  {report}", *(next_lines(*then) if then else [])]


def read_overlays(given: Sequence[str]) -> list[Published]:
    """The tables of `FILE[:LABEL]`; InvalidFile with every head and cell that is wrong, of all files."""
    found, problems = [], list[Problem]()
    for text in given:
        path, label = _parted(text)
        try:
            found.append(_read(path, label))
        except InvalidFile as error:
            problems += error.problems
    if problems:
        raise InvalidFile(problems)
    names = [table.label for table in found]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise UsageError(f'--overlay: two are called "{twice[0]}"; give labels, FILE.csv:LABEL')
    return found


def _parted(text: str) -> tuple[Path, str]:
    """File and label; a colon in the name of a file that is there is no label."""
    if Path(text).exists():
        return Path(text), Path(text).stem
    name, colon, label = text.rpartition(":")
    if not colon:
        return Path(text), Path(text).stem
    return Path(name), label.strip() or Path(name).stem


def _read(path: Path, label: str) -> Published:
    from pmabench.files.table import numbers, read_table
    from pmabench.report.overlays import COORDINATES, HEADS, Published

    table = read_table(path)
    chosen: dict[str, tuple[Column, str, str | None]] = {}
    problems = []
    for column in table.columns:
        found = _meaning(column)
        if found is None:
            continue
        name, quantity, unit = found
        if name in chosen:
            problems.append(table.problem(column.head, f"a second column of {name}"))
        chosen[name] = (column, quantity, unit)
    if problems:
        raise InvalidFile(problems)
    values = [name for name in chosen if name not in COORDINATES]
    if not values or len(values) == len(chosen):
        heads = ", ".join(f'"{names[0]} [{QUANTITIES[quantity].shown_in}]"' for _, quantity, names in HEADS)
        raise invalid(
            path, f"a coordinate and a value over it are expected, of: {heads}", table.columns[0].head.line, 1
        )
    columns, _ = numbers(table, list(chosen.values()), blank=True)
    return Published(label, table.source, path, dict(zip(chosen, columns, strict=True)))


def _meaning(column: Column) -> tuple[str, str, str | None] | None:
    """Name, quantity and unit of a column: the first of its meanings whose unit fits, else the first."""
    from pmabench.files.table import Wanted, meaning, unit_scale
    from pmabench.report.overlays import HEADS

    able = []
    for name, quantity, heads in HEADS:
        found = meaning(column, [Wanted(heads, quantity)])
        if found is not None:
            able.append((name, quantity, found[1]))
    for name, quantity, unit in able:
        try:
            unit_scale(unit, quantity)
        except ValueError:
            continue
        return name, quantity, unit
    return able[0] if able else None
