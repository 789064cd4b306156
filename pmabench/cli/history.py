"""`pmabench history`: one specimen over its life, from its runs and the analyses next to them; computes no fit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from pmabench.base.errors import InvalidFile, UsageError, invalid
from pmabench.cli.common import Ui, common, fields, no_pipes
from pmabench.cli.names import HTML, PATH
from pmabench.files.shipped import find_file
from pmabench.report.terminal import print_grid

if TYPE_CHECKING:
    from pmabench.analysis.verdict.life import Past, References, Series, Use
    from pmabench.store.analyses.results import Analysis, Finding
    from pmabench.store.catalogue import Row
    from pmabench.store.records import Event

Thing = TypeVar("Thing")
Read = TypeVar("Read")


@click.command(name="history")
@click.argument("specimen")
@click.argument("folder", default="runs", type=PATH)
@click.option("-o", "--output", type=HTML, help="Write figures and tables (HTML).")
@common
def command(ui: Ui, specimen: str, folder: Path, output: Path | None) -> None:
    """One SPECIMEN over its life: coefficients, cycles and time at pressure from its runs in FOLDER.

    SPECIMEN is a specimen file, the name of a shipped one, or a serial number as in the runs. Coefficients come from
    the analyses next to the runs (`process` makes them); simulated runs are never mixed with real ones.
    """
    from pmabench.analysis.verdict.life import chosen, findings, references_of, series_of
    from pmabench.cli.sources import analyses_of
    from pmabench.store.analyses.folder import read_analysis
    from pmabench.store.reader import open_run

    if not folder.is_dir():
        raise invalid(folder, "there is no such folder; give the folder that holds the runs")
    no_pipes(output)
    rows, notes = _of_specimen(specimen, folder)
    life, referring, leaks = _life(ui, folder, rows)
    mine = {past.run for past in life}
    written = _readable(ui, analyses_of(folder), read_analysis, "left out")
    analyses = [analysis for _, analysis in written if not mine.isdisjoint(analysis.runs)]
    series = series_of([*analyses, *leaks], life)
    loaded = _readable(ui, referring, lambda row: open_run(folder / row.folder), "its reference trials are left out")
    references = references_of((run for _, run in loaded), life)
    remarks = [*findings(life, chosen(series), references), *notes]
    if not series_of(analyses, life):
        none = "no analysis next to these runs has a coefficient that is followed: pmabench process makes them"
        remarks.append(_note(none))
    title = next(row.specimen for row in rows)
    data = _json(title, life, series, references, remarks)
    if output is not None:
        from pmabench.report.other_pages import write_history

        data["path"] = str(write_history(title, life, series, references, remarks, output))
    ui.result(data, lambda: _print(ui, life, series, remarks, data.get("path")))


def _note(text: str) -> Finding:
    from pmabench.store.analyses.results import Finding

    return Finding("note", text)


def _of_specimen(text: str, folder: Path) -> tuple[list[Row], list[Finding]]:
    """The runs of the specimen, sessions and calibrations too, and what was left out; InvalidFile for none."""
    from pmabench.store.catalogue import catalogue

    rows = catalogue(folder)
    names = _names(text)
    mine = [row for row in rows if any(row.specimen == name or row.specimen.endswith(f" {name}") for name in names)]
    several = sorted({row.specimen for row in mine})
    if len(several) > 1:
        raise UsageError(f'"{text}" could be {" or ".join(several)}; give type and serial')
    if not mine:
        known = ", ".join(sorted({row.specimen for row in rows if row.specimen})) or "none"
        raise invalid(folder, f'holds no run of "{text}"; the specimens of its runs: {known}')
    real = [row for row in mine if not row.simulated] or mine
    left_out = len(mine) - len(real)
    return real, [_note(f"{left_out} simulated runs of this specimen are left out")] if left_out else []


def _names(text: str) -> set[str]:
    """What a run may call the specimen: the text itself, or type and serial of the file that it names."""
    from pmabench.bench.files.specimen import SpecimenFile
    from pmabench.files.document import read_document, validate

    path = Path()
    with suppress(InvalidFile):
        path = find_file("specimen", text)
    if not path.is_file():
        return {text}
    specimen = validate(SpecimenFile, read_document(path))
    return {f"{specimen.type} {specimen.serial}"}


def _life(ui: Ui, folder: Path, rows: Sequence[Row]) -> tuple[list[Past], list[Row], list[Analysis]]:
    """The runs in order of time, with what each did to the specimen; those with reference trials; leaks of self-tests.

    One that cannot be read is reported and left out.
    """
    from pmabench.analysis.verdict.life import leak_of, pasts, use_of
    from pmabench.store.reader import RunFiles, events_of

    used: list[tuple[str, str, str, str, str, bool, int, Use]] = []
    referring, leaks = [], []

    def opened(row: Row) -> tuple[RunFiles, tuple[Event, ...]]:
        files = RunFiles(folder / row.folder)
        return files, tuple(events_of(files.journal()))

    for row, (files, events) in _readable(ui, rows, opened, "its cycles are not counted"):
        before = _cycles_before(files.manifest)
        used.append((row.id, row.date, row.kind, row.bench, row.status, row.simulated, before, use_of(events)))
        if any(event.kind == "trial-begin" and event.data.get("reference") for event in events):
            referring.append(row)
        if (leak := leak_of(row.id, events, simulated=row.simulated)) is not None:
            leaks.append(leak)
    if not used:
        raise invalid(folder, "none of the runs of this specimen can be read; pmabench runs verify says more")
    return pasts(used), referring, leaks


def _cycles_before(manifest: Mapping[str, Any]) -> int:
    """Cycles before the run by its specimen file."""
    specimen = manifest.get("specimen")
    cycles = specimen.get("cycles_before") if isinstance(specimen, Mapping) else 0
    return cycles if type(cycles) is int else 0


def _readable(
    ui: Ui, things: Iterable[Thing], read: Callable[[Thing], Read], otherwise: str
) -> Iterator[tuple[Thing, Read]]:
    """Each thing with what is read of it; one that cannot be read is reported, with what follows, and left out."""
    for thing in things:
        try:
            yield thing, read(thing)
        except InvalidFile as error:
            ui.note(f"{error}; {otherwise}")


def _json(
    title: str, life: list[Past], series: list[Series], references: list[References], remarks: list[Finding]
) -> dict[str, Any]:
    return {
        "schema": "pmabench.history/1",
        "specimen": title,
        "simulated": any(past.simulated for past in life),
        "runs": [
            fields(past, "run", "date", "kind", "bench", "status")
            | fields(past.use, "cycles", "strokes")
            | {"cycles_before": past.before}
            | {"time_at_pressure": past.use.at_pressure, "highest_pressure": past.use.highest}
            for past in life
        ],
        "series": [
            fields(one.first, "symbol", "at", "unit", "method")
            | {
                "kind": one.kind,
                "values": [
                    fields(moment, "date", "cycles", "run")
                    | {"value": moment.estimate.value, "half_width": moment.estimate.parts.combined}
                    for moment in one.moments
                ],
            }
            for one in series
        ],
        "references": [
            {
                "point": dict(one.point),
                "strokes": [
                    {"date": date, "cycles": cycles, "trial": trial, "stroke": stroke}
                    for date, cycles, stroke, trial in one.moments
                ],
                "days": [{"date": date, "stroke": stroke} for date, _, stroke, _ in one.days],
                "limits": None if one.chart is None else fields(one.chart, "centre", "low", "high"),
                "beyond": [] if one.chart is None else list(one.chart.beyond),
                "shifted": None if one.chart is None else one.chart.shifted,
            }
            for one in references
        ],
        "findings": [fields(f, "level", "text") for f in remarks],
    }


def _print(
    ui: Ui, life: Sequence[Past], series: Sequence[Series], remarks: Sequence[Finding], path: str | None
) -> None:
    from pmabench.plotting.wording import clean
    from pmabench.report.other_pages import run_rows, value_rows

    console = ui.console(columns=160)
    if any(past.simulated for past in life):
        console.print("SIMULATED")
    for heads, rows in (run_rows(life), value_rows(life, series)):
        if rows:
            print_grid(console, heads, rows, ("date", "kind", "status", "bench"), 1)
            console.print()
    for finding in remarks:
        console.print(f"{finding.level}: {clean(finding.text)}")
    if path is not None:
        click.echo(path)
