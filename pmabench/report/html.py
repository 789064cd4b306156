"""A characterisation report as one HTML file that references nothing outside itself; computes no estimate.

The same input gives the same bytes. Every text is untrusted: Jinja2 escapes all of it.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd

from pmabench import __version__
from pmabench.analysis.reduce import verdicts
from pmabench.analysis.results import Analysis, Estimate
from pmabench.base.errors import RecordError
from pmabench.report import overlays, provenance, tables, wording
from pmabench.report.figures import front_pictures, kind_pictures
from pmabench.report.pictures import Picture
from pmabench.report.rounding import rounded
from pmabench.report.run_notes import notes_of
from pmabench.report.svg import symbol_parts
from pmabench.store.folder import plain
from pmabench.store.records import RunData

TILES = 8
FRONT_FINDINGS = 5
MOST_ROWS = 600
BRIEF = 28
"""Letters of a text that is kept on one line."""
SHORT = 16
"""Rows of a table that is not broken across pages."""
MOST_FRONT_FINDINGS = 9
"""Where so many are faults or doubts."""
FEWEST_IN_GROUP = 3
"""Rows a method, from which on methods become headings of groups of rows instead of a column."""
LEVELS = {"fault": "Fault", "doubt": "Doubt", "note": "Note"}
_PAIR = re.compile(r"(−?[\d.]+) ± ([\d.]+)")
_NUMBER = re.compile(r"[−-]?[\d.,]+(×10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")


@dataclass(frozen=True)
class Cell:
    """A cell: its text, or value and half width apart so that columns align at the sign."""

    text: str
    half: str = ""
    muted: bool = False


@dataclass(frozen=True)
class Column:
    """How a column is set."""

    head: str
    align: str
    """`pair`, `number`, `brief` (not to be broken into lines) or `text`."""


@dataclass(frozen=True)
class Grid:
    """A table ready for the template; `groups` are (heading or empty, rows)."""

    columns: list[Column]
    groups: list[tuple[str, list[list[Cell]]]]
    caption: str = ""

    @property
    def width(self) -> int:
        """Number of HTML columns."""
        return sum(2 if column.align == "pair" else 1 for column in self.columns)

    @property
    def short(self) -> bool:
        """Whether it can be kept on one page."""
        return sum(len(rows) for _, rows in self.groups) <= SHORT


@dataclass(frozen=True)
class Tile:
    """A key number of the first page."""

    symbol: str
    name: str
    value: str
    unit: str
    where: str
    reach: str


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


def write_report(
    analyses: Sequence[Analysis],
    runs: Sequence[RunData],
    path: Path,
    *,
    title: str | None = None,
    published: Sequence[overlays.Published] = (),
) -> Path:
    """Write the report of `analyses`, with what `runs` tell of bench, specimen and protocol, to `path`.

    `published` tables are drawn beside. Raises RecordError where it cannot be written, InvalidFile for a table that
    matches no figure.
    """
    text = render(analyses, runs, title=title, published=published)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        raise RecordError(f"{path}: the report cannot be written: {error.strerror or error}") from error
    return path


def render(
    analyses: Sequence[Analysis],
    runs: Sequence[RunData],
    *,
    title: str | None = None,
    published: Sequence[overlays.Published] = (),
) -> str:
    """The report as text."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("pmabench.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["sym"] = symbols_marked
    environment.filters["css"] = css_text
    return environment.get_template("report.html.j2").render(_context(analyses, runs, title, published)) + "\n"


def symbols_marked(text: object) -> Any:
    """Escaped text with symbols in italics and their subscripts lowered."""
    from markupsafe import Markup

    tags = {"symbol": ("<i>", "</i>"), "sub": ("<sub>", "</sub>"), "text": ("", "")}
    parts = symbol_parts(str(text))
    return Markup("".join(f"{tags[kind][0]}{escape(part)}{tags[kind][1]}" for kind, part in parts))  # noqa: S704


def css_text(text: object) -> Any:
    """Text inside a CSS string: everything but letters, digits and blanks as an escape."""
    from markupsafe import Markup

    inert = (c if c.isascii() and (c.isalnum() or c == " ") else f"\\{ord(c):06x} " for c in wording.clean(text, 90))
    return Markup("".join(inert))  # noqa: S704


def _context(
    analyses: Sequence[Analysis],
    runs: Sequence[RunData],
    title: str | None,
    published: Sequence[overlays.Published],
) -> dict[str, Any]:
    order = wording.in_order((a.kind for a in analyses), wording.KINDS)
    analyses = sorted(analyses, key=lambda a: order.index(a.kind))
    runs = sorted({run.id: run for run in runs}.values(), key=lambda run: run.id)
    ids = dict.fromkeys([run.id for run in runs] + [run for a in analyses for run in a.runs])
    names = {run: f"R{n}" for n, run in enumerate(ids, 1)}
    simulated = [a.simulated for a in analyses] + [run.simulated for run in runs]
    figures = _Figures()
    identity = _identity(analyses, runs, published)
    analyses, theirs, compared = overlays.beside(analyses, published, overlays.length_of(runs))
    front, used = front_pictures([*analyses, *theirs])
    first_page = [figures.add(p) for p in front]
    sections = [_section(a, figures, used) for a in analyses if a.estimates or a.kind != wording.AGREEMENT]
    judged = [run for run in runs if provenance.accepts(run)]
    failed = [wording.clean(text) for text in verdicts(judged, analyses)]
    accepted = {symbol: widest for run in judged for symbol, widest in provenance.accepts(run).items()}
    findings = tables.findings_table(analyses)
    specimens = provenance.specimens(runs)
    kinds = [wording.kind_title(a.kind) for a in analyses if a.kind != wording.AGREEMENT]
    tested = ", ".join(title.lower() if n else title for n, title in enumerate(kinds))
    name = (
        wording.clean(title, 200)
        if title
        else f"Characterisation of {specimens[0][0] if specimens else 'a pneumatic muscle'}"
    )
    methods = list(dict.fromkeys(e.method for a in analyses for e in a.estimates))
    return {
        "title": name,
        "version": __version__,
        "report_id": identity,
        "simulated": any(simulated),
        "mixed": any(simulated) and not all(simulated),
        "specimens": specimens,
        "benches": provenance.benches(runs),
        "tested": tested,
        "when": provenance.when(runs),
        "operators": provenance.operators(runs),
        "statuses": provenance.statuses(runs),
        "missing": [wording.clean(run, 200) for run in ids if run not in {r.id for r in runs}],
        "failed": failed,
        "accept": [f"{symbol} ± {100 * widest:g} %" for symbol, widest in accepted.items()],
        "verdicts": _first_findings(findings),
        "findings": findings.to_numpy().tolist(),
        "levels": LEVELS,
        "tiles": _tiles(analyses),
        "front": first_page,
        "protocol": grid(provenance.protocol_table(runs, names)),
        "deviations": provenance.deviations(runs, names),
        "notes": notes_of(runs, names),
        "coefficients": grid(*tables.primary_table(analyses)),
        "compared": [grid(t.frame, t.caption) for t in tables.method_tables(analyses)],
        "curves": grid(tables.curves_table(analyses), group=True),
        "polynomials": grid(tables.polynomials_table(analyses), group=True),
        "sections": sections,
        "published": grid(overlays.comparison_table(compared)),
        "publishers": [(wording.clean(p.label, 80), wording.clean(p.source, 600)) for p in published],
        "tuning": _tuning(analyses),
        "dropped": _dropped(analyses, names),
        "methods": _methods(methods),
        "runs": grid(provenance.run_table(runs, names), group=False),
        "run_details": [list(row.items()) for row in provenance.run_table(runs, names).to_dict("records")],
        "calibrations": grid(provenance.calibration_table(runs, names), group=False),
        "versions": provenance.versions(runs),
    }


class _Figures:
    """Numbers figures in the order in which they come."""

    def __init__(self) -> None:
        self.count = 0

    def add(self, picture: Picture) -> Numbered:
        self.count += 1
        return Numbered(self.count, picture, grid(picture.table))


def _identity(analyses: Sequence[Analysis], runs: Sequence[RunData], published: Sequence[overlays.Published]) -> str:
    data = plain({"analyses": [a.to_dict() for a in analyses], "runs": [run.id for run in runs]})
    if published:
        data["published"] = [
            [p.label, {name: values.tolist() for name, values in p.columns.items()}] for p in published
        ]
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:12]


def _section(analysis: Analysis, figures: _Figures, used: Sequence[str]) -> Section:
    trials = analysis.facts.get("trials_used", analysis.facts.get("trials"))
    dropped = len(analysis.dropped)
    counts = f"{len(analysis.runs)} run{'s' if len(analysis.runs) != 1 else ''}"
    if isinstance(trials, int) and not isinstance(trials, bool):
        counts += f", {trials} trials used"
    counts += f", {dropped} not used" if dropped else ", all trials used" if isinstance(trials, int) else ""
    section = Section(wording.kind_title(analysis.kind), analysis.simulated, counts)
    section.tables = [grid(t.frame, wording.clean(t.caption)) for t in tables.other_tables(analysis)]
    section.figures = [figures.add(p) for p in kind_pictures(analysis, used)]
    parts = tables.parts_table(analysis)
    section.parts = grid(parts) if len(parts) else None
    return section


def grid(frame: pd.DataFrame, caption: str = "", *, group: bool | None = None) -> Grid:
    """A frame of text as a table: columns of `a ± b` split, empty columns left out.

    Methods become headings of groups of rows with `group`, or where it is None and that makes few headings.
    """
    if len(frame) > MOST_ROWS:
        caption = f"{caption}; the first {MOST_ROWS} of {len(frame)}, all lie in the analysis folder".lstrip("; ")
        frame = frame.head(MOST_ROWS)
    shown_columns = [c for c in frame.columns if len(frame) == 0 or any(str(v) != "" for v in frame[c])]
    methods = frame["method"].nunique() if "method" in shown_columns else 0
    few = methods == 1 or len(frame) >= FEWEST_IN_GROUP * methods
    grouped = methods > 0 and (few if group is None else group)
    columns = []
    for name in shown_columns:
        if grouped and name == "method":
            continue
        values = [str(v) for v in frame[name] if str(v) not in ("", "not identifiable")]
        align = "text"
        if values and all(_PAIR.fullmatch(v) for v in values):
            align = "pair"
        elif values and all(_NUMBER.fullmatch(v) for v in values) and name not in ("run", "trial"):
            align = "number"
        elif all(len(str(v)) <= BRIEF for v in frame[name]):
            align = "brief"
        columns.append(Column(str(name), align))
    groups: list[tuple[str, list[list[Cell]]]] = []
    for record in frame.to_dict("records"):
        heading = str(record["method"]) if grouped else ""
        if not groups or groups[-1][0] != heading:
            groups.append((heading, []))
        groups[-1][1].append([_cell(str(record[c.head]), c.align) for c in columns])
    return Grid(columns, groups, caption)


def _cell(text: str, align: str) -> Cell:
    pair = _PAIR.fullmatch(text) if align == "pair" else None
    if pair:
        return Cell(pair[1], pair[2])
    return Cell(text, muted=text == "not identifiable")


def _first_findings(findings: pd.DataFrame) -> tuple[list[tuple[str, str, str]], int]:
    """The findings for the first page, gravest first, and how many more there are."""
    rows = [(level, test, text) for level, test, text in findings.to_numpy().tolist()]
    grave = sum(level in ("fault", "doubt") for level, _, _ in rows)
    shown_there = min(len(rows), max(FRONT_FINDINGS, min(grave, MOST_FRONT_FINDINGS)))
    return rows[:shown_there], len(rows) - shown_there


def _tiles(analyses: Sequence[Analysis]) -> list[Tile]:
    """Key numbers: each headline symbol by the method of its test that comes first, at the middle of what was tested.

    Where that method found none (no limit cycle) there is none: what others give, as a simulation, is no key number.
    """
    found = []
    for symbol in wording.HEADLINES:
        for analysis in analyses:
            told = [e for e in analysis.estimates if e.symbol == symbol and "frequency" not in e.at]
            known = [e for e in told if e.value is not None and e.method == told[0].method]
            members = [e for e in known if set(e.at) == set(known[0].at)]
            if members:
                found.append(_tile(members))
                break
    if any(tile.symbol in ("B_c", "B_r") for tile in found):
        found = [tile for tile in found if tile.symbol != "B"]
    return found[:TILES]


def _tile(members: list[Estimate]) -> Tile:
    varying = [
        name for name in wording.in_order(members[0].at, members[0].at) if len({e.at[name] for e in members}) > 1
    ]
    members = sorted(members, key=lambda e: [e.at[name] for name in varying])
    middle = members[len(members) // 2]
    unit = wording.shown(middle.quantity, middle.unit)
    value = tables.cell(middle)
    shown_at = {
        name: middle.at[name] for name in (varying or wording.in_order(middle.at, ("pressure", "setpoint"))[:1])
    }
    reach = ""
    if len(members) > 1 and len(varying) == 1:
        _, at_unit = wording.point_shown(varying[0])
        ends = [(e.value or 0.0) / unit.scale for e in (members[0], members[-1])]
        places = [wording.number(e.at[varying[0]] / at_unit.scale) for e in (members[0], members[-1])]
        reach = (
            f"{rounded(ends[0], None, 3)} to {rounded(ends[1], None, 3)} from {places[0]} to {places[1]} {at_unit.unit}"
        )
    name = wording.SYMBOLS.get(middle.symbol, "")
    where = ", ".join(part for part in (wording.point_text(shown_at), wording.clean(middle.method, 60)) if part)
    return Tile(wording.symbol_text(middle.symbol), name, value, unit.unit, where, reach.strip())


def _tuning(analyses: Sequence[Analysis]) -> list[Grid]:
    """For each operating point a table of settings, and one of margins where a model is known."""
    frame = tables.tuning_table(analyses)
    found = []
    for point in dict.fromkeys(str(point) for point in frame["operating point"]) if len(frame) else ():
        rows = frame[frame["operating point"] == point].drop(columns="operating point")
        settings = [
            c for c in rows.columns if c == "rule" or c.partition(" [")[0] in ("K_p", "T_i", "T_d", "K_i", "K_d")
        ]
        margins = ["rule", *(c for c in rows.columns if c not in settings)]
        where = f" at {point}" if point else ""
        found.append(grid(rows[settings], f"Settings{where}"))
        if len(margins) > 1 and (rows[margins[1:]] != "").any(axis=None):
            found.append(grid(rows[margins], f"Margins with these settings{where}"))
    return found


def _methods(methods: Sequence[str]) -> list[tuple[str, str]]:
    """Names and descriptions; methods with one description stand together."""
    found: dict[str, list[str]] = {}
    for method in methods:
        told = (
            wording.METHODS.get(method) or wording.METHODS.get(method.partition(" above ")[0]) or "Not described here."
        )
        found.setdefault(told, []).append(wording.clean(method, 120))
    return [("; ".join(names), told) for told, names in found.items()]


def _dropped(analyses: Sequence[Analysis], names: Mapping[str, str]) -> Grid:
    frame = tables.dropped_table(analyses)
    frame["trial"] = [_short(trial, names) for trial in frame["trial"]]
    return grid(frame.rename(columns={"test": "method"})) if len(frame) else grid(frame)


def _short(trial: str, names: Mapping[str, str]) -> str:
    run, slash, index = trial.rpartition("/")
    return f"{names[run]} / {index}" if slash and run in names else trial
