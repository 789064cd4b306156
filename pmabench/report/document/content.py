"""What a characterisation report says: texts, tables and figures in their order, and as an HTML page; no estimate.

PDF and workbook are made from the same content. Every text in it is untrusted and stays text in each of them. The page
is one file that references nothing outside itself; the same input gives the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pmabench import __version__
from pmabench.analysis.verdict.acceptance import limits_of
from pmabench.kinds import registry
from pmabench.kinds.reduce import verdicts
from pmabench.plotting import wording
from pmabench.plotting.pictures import Picture
from pmabench.plotting.svg import as_file
from pmabench.plotting.wording import printed
from pmabench.report import overlays
from pmabench.report.certificate.interactive import assets, chart_data
from pmabench.report.certificate.sheet import Sheet, sheet_of
from pmabench.report.document import provenance, tables
from pmabench.report.document.deviations import Issuer, Item, Said, checklist, deviations, notes_of
from pmabench.report.document.grids import Grid, grid, narrow
from pmabench.report.document.special_tables import budget_table, change_tables, check_tables, reduced_with
from pmabench.report.document.special_tables import who as who_changed
from pmabench.report.figures import kind_pictures
from pmabench.report.foremost import Tile, Verdict, tiles_of, verdict_of
from pmabench.report.words import declared, described, distinct, kind_title
from pmabench.report.writing import render, write_file
from pmabench.store.analyses.results import AGREEMENT, Analysis
from pmabench.store.folder import plain
from pmabench.store.records import RunData

LEVELS = {"fault": "Fault", "doubt": "Doubt", "note": "Note"}


@dataclass(frozen=True)
class Numbered:
    """A figure with its number and its numbers."""

    n: int
    picture: Picture
    grid: Grid


@dataclass
class Section:
    """What one kind of test adds to the report."""

    title: str
    simulated: bool
    counts: str
    tables: list[Grid] = field(default_factory=list)
    figures: list[Numbered] = field(default_factory=list)
    parts: Grid | None = None
    budget: Grid | None = None


@dataclass(frozen=True)
class Content:
    """The content of a report; tables are grids of text, figures carry their SVG and their numbers."""

    title: str
    version: str
    report_id: str
    simulated: bool
    mixed: bool
    specimens: list[tuple[str, str]]
    benches: list[tuple[str, str]]
    tested: str
    when: str
    operators: str
    statuses: str
    missing: list[str]
    verdict: Verdict
    failed: list[str]
    findings: list[list[str]]
    """Level, test and text."""
    tiles: list[Tile]
    """Key numbers, for the workbook."""
    sheet: Sheet
    front: list[Numbered]
    """Figures of the first page, then of the second."""
    protocol: Grid
    deviations: list[str]
    notes: list[Said]
    coefficients: list[Grid]
    compared: list[Grid]
    curves: Grid
    polynomials: Grid
    sections: list[Section]
    published: Grid
    publishers: list[tuple[str, str]]
    tuning: list[Grid]
    dropped: Grid
    methods: list[tuple[str, str]]
    run_details: list[list[tuple[str, str]]]
    calibrations: Grid
    versions: list[str]
    issuer: Issuer
    checklist: list[Item]

    @property
    def figures(self) -> list[Numbered]:
        """All figures in their order."""
        return [*self.front, *(figure for section in self.sections for figure in section.figures)]


def content_of(
    analyses: Sequence[Analysis],
    runs: Sequence[RunData],
    *,
    title: str | None = None,
    published: Sequence[overlays.Published] = (),
    issuer: Issuer | None = None,
) -> Content:
    """What there is to say of `analyses` and of the `runs` behind them, compared with the tables `published`.

    Raises InvalidFile for a published table that matches no figure.
    """
    order = wording.in_order((a.kind for a in analyses), registry.all_kinds())
    analyses = sorted(analyses, key=lambda a: order.index(a.kind))
    runs = sorted({run.id: run for run in runs}.values(), key=lambda run: run.id)
    ids = dict.fromkeys([run.id for run in runs] + [run for a in analyses for run in a.runs])
    names = {run: f"R{n}" for n, run in enumerate(ids, 1)}
    simulated = [a.simulated for a in analyses] + [run.simulated for run in runs]
    figures = _Figures()
    identity = _identity(analyses, runs, published)
    failed = [wording.clean(text) for text in verdicts(runs, analyses)]
    analyses, theirs, compared = overlays.with_published(distinct(analyses), published, overlays.length_of(runs))
    accepted = any(limits_of(run) for run in runs)
    verdict = verdict_of(analyses, runs, failed, accepted=accepted)
    sheet = sheet_of(analyses, theirs, runs, names, verdict, failed)
    front = [figures.add(p) for p in (*sheet.first, *sheet.second)]
    sections = [_section(a, figures, sheet.used, names) for a in analyses if a.estimates or a.kind != AGREEMENT]
    about_runs = _about_runs(runs, names)
    when = about_runs["when"]
    specimen = next((name for name, _ in about_runs["specimens"] if name != provenance.UNNAMED), "")
    kinds = [kind_title(a.kind) for a in analyses if a.kind != AGREEMENT]
    name = wording.clean(title, 200) if title else f"Characterisation of {specimen or 'a pneumatic muscle'}"
    changed = [f"{', '.join(names.get(run, '?') for run in where)}: {text}" for where, text in who_changed(analyses)]
    remarks = [*dict.fromkeys(changed), *deviations(runs, names)]
    who = (issuer or Issuer()).cleaned()
    return Content(
        title=name,
        version=__version__,
        report_id=identity,
        simulated=any(simulated),
        mixed=any(simulated) and not all(simulated),
        tested=", ".join(title.lower() if n else title for n, title in enumerate(kinds)),
        verdict=verdict,
        failed=[printed(text) for text in failed],
        missing=[wording.clean(run, 200) for run in ids if run not in {r.id for r in runs}],
        sheet=sheet,
        front=front,
        deviations=remarks,
        sections=sections,
        published=grid(overlays.comparison_table(compared)),
        publishers=[(wording.clean(p.label, 80), wording.clean(p.source, 600)) for p in published],
        calibrations=grid(provenance.calibration_table(runs, names, reduced_with(analyses)), group=False),
        issuer=who,
        checklist=checklist(analyses, runs, who, specimen=specimen, when=when, deviations=remarks, accepted=accepted),
        **about_runs,
        **_results(analyses, names),
    )


def write_page(content: Content, path: Path) -> Path:
    """Write a report's content as a page; raises RecordError where it cannot be written."""
    return write_file(path, page_of(content), "the report")


def page_of(content: Content, *, long: bool = False) -> str:
    """The content as an HTML page: two pages, and appendices, which are folded, or open and printed with `long`."""
    charts = chart_data([(item.n, item.picture) for item in content.figures])
    more = {"levels": LEVELS, "long": long, "charts": charts, "assets": assets()}
    return render("report.html.j2", vars(content) | more)


def _findings(analyses: Sequence[Analysis], names: Mapping[str, str]) -> list[list[str]]:
    """Level, test and text of every finding, with runs as the report names them."""
    cells = tables.findings_table(analyses).cells()
    return [[level, test, _named(text, names)] for level, test, text in cells]


def _about_runs(runs: Sequence[RunData], names: Mapping[str, str]) -> dict[str, Any]:
    """Fields of `Content` that the runs alone give."""
    details = provenance.run_table(runs, names).rows
    return {
        "specimens": provenance.specimens(runs),
        "benches": provenance.benches(runs),
        "when": provenance.when(runs),
        "operators": provenance.operators(runs),
        "statuses": provenance.statuses(runs),
        "protocol": grid(provenance.protocol_table(runs, names)),
        "notes": notes_of(runs, names),
        "run_details": [[(str(head), str(text)) for head, text in row.items()] for row in details],
        "versions": provenance.versions(runs),
    }


def _results(analyses: Sequence[Analysis], names: Mapping[str, str]) -> dict[str, Any]:
    """Fields of `Content` with findings, coefficients, curves and methods."""
    return {
        "findings": _findings(analyses, names),
        "tiles": tiles_of(analyses),
        "coefficients": _primary(analyses),
        "compared": [grid(t.frame, t.caption) for t in tables.method_tables(analyses)],
        "curves": grid(tables.curves_table(analyses), group=True),
        "polynomials": grid(tables.polynomials_table(analyses), group=True),
        "tuning": _tuning(analyses),
        "dropped": _dropped(analyses, names),
        "methods": _methods(list(dict.fromkeys(e.method for a in analyses for e in a.estimates))),
    }


class _Figures:
    """Numbers the figures of a report in their order, and remembers which were drawn."""

    def __init__(self) -> None:
        self.count = 0
        self.drawn: set[str] = set()

    def add(self, picture: Picture) -> Numbered:
        self.count += 1
        self.drawn.add(picture.svg)
        return Numbered(self.count, picture, grid(picture.table))


def _identity(analyses: Sequence[Analysis], runs: Sequence[RunData], published: Sequence[overlays.Published]) -> str:
    data = plain({"analyses": [a.to_dict() for a in analyses], "runs": [run.id for run in runs]})
    if published:
        data["published"] = [[p.label, {name: v.tolist() for name, v in p.columns.items()}] for p in published]
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:12]


def _section(analysis: Analysis, figures: _Figures, used: Sequence[str], names: Mapping[str, str]) -> Section:
    trials = next((analysis.facts[name] for name in ("trials_used", "trials", "tests") if name in analysis.facts), None)
    dropped = len(analysis.dropped)
    counts = f"{len(analysis.runs)} run{'s' if len(analysis.runs) != 1 else ''}"
    if isinstance(trials, int) and not isinstance(trials, bool):
        counts += f", {trials} trials used"
    counts += f", {dropped} not used" if dropped else ", all trials used" if isinstance(trials, int) else ""
    titles = {result.symbol: result.title for result in declared([analysis]).values()}
    given = dict.fromkeys(e.symbol for e in analysis.estimates if titles.get(e.symbol))
    if given:
        counts += ". " + "; ".join(f"{wording.symbol_text(one)}: {wording.clean(titles[one], 80)}" for one in given)
    section = Section(kind_title(analysis.kind), analysis.simulated, counts)
    values = [part for table in tables.other_tables(analysis) for part in narrow(table)]
    shown = (*values, *check_tables(analysis), *change_tables(analysis))
    section.tables = [grid(t.frame, wording.clean(t.caption)) for t in shown]
    section.figures = [figures.add(p) for p in kind_pictures(analysis, used) if p.svg not in figures.drawn]
    parts = tables.parts_table(analysis, names)
    section.parts = grid(parts, notes="note") if len(parts) else None
    budget = budget_table(analysis)
    section.budget = grid(budget.frame, budget.caption) if budget else None
    return section


def _primary(analyses: Sequence[Analysis]) -> list[Grid]:
    """The coefficients of the primary methods, in as many tables as a page needs."""
    frame, methods = tables.primary_table(analyses)
    caption = "Primary methods, by pressure" + (f"; {methods}" if methods else "")
    return [grid(part.frame, part.caption) for part in narrow(tables.Table(caption, frame)) if len(part.frame)]


def _tuning(analyses: Sequence[Analysis]) -> list[Grid]:
    """For each operating point a table of settings, and one of margins where a model is known."""
    frame = tables.tuning_table(analyses)
    found = []
    for point in dict.fromkeys(frame["operating point"] if len(frame) else ()):
        rows = frame.where(cell == point for cell in frame["operating point"]).without("operating point")
        gains = ("rule", "K_p", "T_i", "T_d", "K_i", "K_d")
        settings = [c for c in rows.columns if c.partition(" [")[0] in gains]
        margins = ["rule", *(c for c in rows.columns if c not in settings)]
        where = f" at {point}" if point else ""
        found.append(grid(rows.select(settings), f"Settings{where}"))
        if rows.select(margins[1:]).filled().columns:
            found.append(grid(rows.select(margins), f"Margins with these settings{where}"))
    return found


def _methods(methods: Sequence[str]) -> list[tuple[str, str]]:
    """Names and descriptions; methods with the same description in one row."""
    found: dict[str, list[str]] = {}
    for method in methods:
        found.setdefault(described(method) or "Not described here.", []).append(wording.clean(method, 120))
    return [("; ".join(names), description) for description, names in found.items()]


def _dropped(analyses: Sequence[Analysis], names: Mapping[str, str]) -> Grid:
    frame = tables.dropped_table(analyses)
    for row in frame.rows:
        run, slash, index = row["trial"].rpartition("/")
        row["trial"] = f"{names[run]} / {index}" if slash and run in names else row["trial"]
    return grid(frame.renamed("test", "method")) if len(frame) else grid(frame)


def _named(text: str, names: Mapping[str, str]) -> str:
    """A sentence with runs and trials as the report names them: `R2 / 25`; signs as in print."""
    for run in sorted(names, key=len, reverse=True):
        text = re.sub(re.escape(run) + r"/(?=\d)", f"{names[run]} / ", text).replace(run, names[run])
    return printed(text)


FONT = "Inter, Helvetica, Arial, sans-serif"
CAPTIONS = "captions.txt"


def write_figures(content: Content, folder: Path) -> Path:
    """Write each figure as SVG, numbered as in the report, and `captions.txt`; the folder. Raises RecordError."""
    lines = [f"{content.title}\n"]
    for item in content.figures:
        short = re.sub(r"[^a-z0-9]+", "-", item.picture.title.lower()).strip("-")[:50].strip("-")
        name = f"{item.n:02d}-{short or 'figure'}.svg"
        write_file(folder / name, as_file(item.picture.svg, FONT), "the figure")
        lines.append(f"{name}\n  Figure {item.n}: {item.picture.title}. {item.picture.caption}\n")
    write_file(folder / CAPTIONS, "\n".join(lines), "the captions")
    return folder
