"""`pmabench compare`: two analyses, two methods, or an analysis and a published table, coefficient by coefficient."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import InvalidFile, UsageError, invalid
from pmabench.cli.common import Ui, common, fields, no_pipes, read_quantity
from pmabench.cli.names import HTML, RunFolder, in_full
from pmabench.report.terminal import print_grid

if TYPE_CHECKING:
    from pmabench.analysis.verdict.comparison import Comparison, Difference, Side
    from pmabench.report.overlays import Comparison as Published
    from pmabench.store.analyses.results import Analysis, Estimate

_LIMIT = re.compile(r"\s*(E_n|difference)\s*(?:<=?|≤|=)\s*(.+?)\s*")


@click.command(name="compare")
@click.argument("a", shell_complete=RunFolder().shell_complete)
@click.argument("b", required=False, shell_complete=RunFolder().shell_complete)
@click.option("--method", "methods", multiple=True, help="Of both; given twice: that of A, then that of B.")
@click.option("--at", "places", multiple=True, metavar="PRESSURE", help="At this pressure; between points by a line.")
@click.option("--accept", "accepted", multiple=True, metavar='"E_n<=1"', help='Exit 6 beyond; also "difference<=2 %".')
@click.option("-o", "--output", type=HTML, help="Write figures and tables (HTML).")
@click.option("--fresh", is_flag=True, help="Compute anew what `process` stored and nothing has changed.")
@common
def command(
    ui: Ui,
    a: str,
    b: str | None,
    methods: tuple[str, ...],
    places: tuple[str, ...],
    accepted: tuple[str, ...],
    output: Path | None,
    fresh: bool,
) -> int | None:
    """Hold A against B, the reference: differences with their 95 % interval and E_n number.

    A and B are analysis folders, folders of them, or runs (processed now, unless `process` did that and nothing has
    changed since); B may be a CSV of published values, with FILE.csv:LABEL. Without B the two methods of A given with
    --method are compared.
    """
    from pmabench.analysis.verdict.comparison import Comparison, compare, not_accepted
    from pmabench.plotting.wording import clean

    limits = [_limit(text) for text in accepted]
    pressures = [read_quantity("--at", text, "pressure") for text in places]
    no_pipes(output)
    if len(methods) > 2 or (b is None and len(methods) != 2):
        raise UsageError("give B, or --method twice to compare two methods of A")
    left, runs = _side(ui, "A", a, fresh=fresh)
    curves: list[Published] = []
    if b is None:
        right, left = replace(left, name=methods[1]), replace(left, name=methods[0])
    elif _is_table(b):
        right, curves = _published(b, left.analyses, runs)
    else:
        right = _side(ui, "B", b, fresh=fresh)[0]
    chosen = None if not methods else (methods[0], None if right.published else methods[-1])
    found = compare(left, right, chosen, pressures) if right.analyses else Comparison((), ())
    if not found.differences and any(measure == "E_n" for measure, _ in limits):
        why = f"{right.name} has no coefficient, and curves have no E_n"
        raise UsageError(f'--accept "E_n...": {why}; limit the difference')
    failed = [text for measure, limit in limits for text in not_accepted(found.differences, measure, limit)]
    failed += [text for measure, limit in limits if measure == "difference" for text in _curves_beyond(curves, limit)]
    data = _json(left, right, found, curves, failed)
    if output is not None:
        from pmabench.report.other_pages import write_comparison

        data["path"] = str(write_comparison(left, right, found, curves, failed, output))
    refusals = [f"NOT ACCEPTED: {clean(text)}" for text in failed]
    last = [*refusals, *([data["path"]] if output else [])]
    ui.result(data, lambda: _print(ui, left, right, found, curves, last), refusals)
    return 6 if failed else None


def _curves_beyond(curves: Sequence[Published], limit: float) -> Iterator[str]:
    """A sentence for each curve whose mean distance from its published points is above `limit`, or not known."""
    for one in curves:
        if one.size is None or not one.size <= limit:
            size = "no point of one's own range" if one.size is None else f"mean size {100 * one.size:.2g} %"
            yield f"{one.name} over {one.over}: {size}, accepted {100 * limit:g} %"


def _limit(text: str) -> tuple[str, float]:
    """`E_n<=1` or `difference<=2 %`."""
    found = _LIMIT.fullmatch(text)
    if found is None:
        raise UsageError(f'--accept "{text}": expected "E_n<=1" or "difference<=2 %"')
    measure, limit = found.groups()
    if measure == "difference":
        value = read_quantity("--accept", limit, "ratio")
    else:
        try:
            value = float(limit)
        except ValueError as error:
            raise UsageError(f'--accept "{text}": "{limit}" is no number; E_n has no unit') from error
    if not 0 < value < float("inf"):
        raise UsageError(f'--accept "{text}": a limit is above 0')
    return measure, value


def _is_table(text: str) -> bool:
    return not Path(text).is_dir() and re.search(r"\.csv(:|$)", text, re.IGNORECASE) is not None


def _side(ui: Ui, name: str, text: str, *, fresh: bool) -> tuple[Side, list[Path]]:
    """The analyses in a path, and the folders of their runs as far as they are at hand."""
    from pmabench.analysis.verdict.comparison import Side
    from pmabench.cli.sources import load_runs, read_all, stored
    from pmabench.kinds.reduce import reduce_runs
    from pmabench.store.analyses.folder import analyses_below, read_analysis, runs_of

    path = in_full(Path(text))
    if _is_table(text):
        raise UsageError(f"{text} is a table; it can only be B, the reference")
    if not path.is_dir():
        raise invalid(path, "there is no such folder; give an analysis folder, a folder of them or a run")
    if (path / "manifest.json").exists():
        analyses = read_all(ui, [] if fresh else stored(ui, [path])) or reduce_runs(load_runs([path]))
        runs = [path]
    else:
        folders = analyses_below(path)
        if not folders:
            raise invalid(path, "holds no analysis; give an analysis folder, a folder of them or a run")
        analyses = [read_analysis(folder) for folder in folders]
        runs = list(dict.fromkeys(run for folder in folders for run in runs_of(folder)))
    from pmabench.store.analyses.results import AGREEMENT

    analyses = [analysis for analysis in analyses if analysis.kind != AGREEMENT]
    known = len({run for analysis in analyses for run in analysis.runs}) == len(runs)
    manifests = [_manifest(run) for run in runs]
    about = [str(path), *dict.fromkeys(filter(None, map(_bench_and_day, manifests)))]
    if (count := _side_by_side(text, manifests)) > 1:
        from pmabench.analysis.verdict.agreement import of_one

        analyses = [of_one(analysis, count) for analysis in analyses]
        about.append(f"{count} muscles side by side: forces and volumes are divided by {count}")
    calibrations = frozenset(item for run in runs for item in _calibrations(run)) if known else None
    return Side(name, tuple(analyses), "; ".join(about), calibrations), runs


def _manifest(run: Path) -> Mapping[str, Any]:
    from pmabench.store.folder import read_manifest

    try:
        return read_manifest(run)
    except InvalidFile:
        return {}


def _side_by_side(name: str, manifests: Sequence[Mapping[str, Any]]) -> int:
    """How many muscles side by side the specimen of all runs is; 1 where nothing says more."""
    from pmabench.analysis.verdict.agreement import side_by_side

    counts = {side_by_side(manifest.get("specimen")) for manifest in manifests}
    if len(counts) > 1:
        several = " and ".join(map(str, sorted(counts)))
        raise UsageError(f"{name} holds runs of specimens of {several} muscles side by side")
    return counts.pop() if counts else 1


def _bench_and_day(manifest: Mapping[str, Any]) -> str:
    bench = manifest.get("bench")
    name = bench.get("name") if isinstance(bench, dict) else bench
    return ", ".join(part for part in (str(name or ""), str(manifest.get("started_utc", ""))[:10]) if part)


def _calibrations(run: Path) -> Iterator[tuple[str, str]]:
    """Scale and calibration of each channel, as the bench or the map of an import gives them, and the session.

    A run without a session, and an import without a day, counts as a session that no other run shares.
    """
    from pmabench.analysis.shared.trials import session_in
    from pmabench.analysis.verdict.comparison import SESSION
    from pmabench.store.reader import RunFiles

    with suppress(InvalidFile):
        files = RunFiles(run)
        for name in files.stream_names():
            for column in json.loads(files.read(f"streams/{name}.json"))["columns"]:
                yield column["name"], json.dumps([column.get("scale"), column.get("calibration")], sort_keys=True)
        imported = files.manifest.get("imported")
        undated = isinstance(imported, dict) and not imported.get("started_known")
        yield SESSION, ("" if undated else session_in(files.manifest)) or run.resolve().name


def _published(text: str, analyses: Sequence[Analysis], runs: Sequence[Path]) -> tuple[Side, list[Published]]:
    """A table as the reference, and how its points compare with the curves of figures."""
    from pmabench.analysis.verdict.comparison import Side
    from pmabench.cli.report import read_overlays
    from pmabench.cli.sources import load_runs
    from pmabench.report.overlays import length_of, with_published

    tables = read_overlays([text])
    (table,) = tables
    length = length_of(load_runs(runs)) if "contraction" in table.columns and runs else None
    _, others, compared = with_published(analyses, tables, length)
    coefficients = {e.symbol for other in others for e in other.estimates}
    about = f"{table.path}; {table.source}" if table.source else str(table.path)
    side = Side(table.label, tuple(others), about, published=True)
    return side, [one for one in compared if one.name not in coefficients]


def _json(
    left: Side, right: Side, found: Comparison, curves: Sequence[Published], failed: Sequence[str]
) -> dict[str, Any]:
    def side(one: Side) -> dict[str, Any]:
        return fields(one, "name", "about", "simulated") | {"runs": sorted(one.runs)}

    def value(e: Estimate) -> dict[str, Any]:
        return fields(e, "value", "n", "method") | {"half_width": e.parts.combined}

    def difference(d: Difference) -> dict[str, Any]:
        about = fields(d.a, "symbol", "coordinate", "at", "unit", "quantity")
        about |= fields(d, "kind", "relative", "agrees", "lacks")
        about |= {"a": value(d.a), "b": value(d.b), "between_points": d.between}
        return about | {"difference": d.value, "half_width": d.half, "E_n": d.score}

    return {
        "schema": "pmabench.comparison/1",
        "a": side(left),
        "b": side(right),
        "differences": [difference(d) for d in found.differences],
        "curves": [vars(one) for one in curves],
        "findings": [fields(f, "level", "text") for f in found.findings],
        "verdicts": list(failed),
    }


def _print(
    ui: Ui, left: Side, right: Side, found: Comparison, curves: Sequence[Published], last: Sequence[str]
) -> None:
    from pmabench.plotting.wording import clean
    from pmabench.report.other_pages import curve_rows, rows_of

    console = ui.console(columns=140)
    for side in (left, right):
        mark = "SIMULATED  " if side.simulated else ""
        console.print(f"{mark}{clean(side.name, 60)}: {clean(side.about, 300)}", soft_wrap=True)
    for heads, rows in (rows_of(left, right, found.differences), curve_rows(curves)):
        if rows:
            console.print()
            print_grid(console, heads, rows, ("symbol", "quantity", "over"), 2)
    console.print()
    for finding in found.findings:
        console.print(f"{finding.level}: {clean(finding.text)}")
    for line in last:
        click.echo(clean(line))
