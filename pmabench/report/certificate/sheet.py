"""Everything that the two pages of the certificate say, put together from analyses and runs; computes no estimate.

A kind of test without K, B or F_ce over pressure gets the same pages with what it has: its values in the one table, its
own figures, its limits. What is not there has no frame.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pmabench.plotting.pictures import Picture, drawable
from pmabench.plotting.svg import capital
from pmabench.plotting.wording import brief, clean, number, spoken
from pmabench.report.certificate import quality
from pmabench.report.certificate.force_chart import force_picture, stroke_picture
from pmabench.report.certificate.quality import Coverage, Sources, coverage, sources
from pmabench.report.certificate.result_table import ResultTable, result_table
from pmabench.report.document import provenance
from pmabench.report.figures import coefficient_picture, front_pictures, surface_picture
from pmabench.report.foremost import Verdict, how_well, left_out, tiles_of, without_run
from pmabench.report.words import described, kind_title
from pmabench.store.analyses.results import AGREEMENT, Analysis, Estimate, Trace
from pmabench.store.records import RunData

FIGURES = 3
MOST_ALSO = 6
USUAL, ROW = 9, 16.0
"""Rows of the table with its notes for which page 1 is laid out; height of each further one [pt]."""
MOST_LETTERS = 480
INTERVALS = (
    "U is the half width of the 95 % interval: scatter between trials, what the estimator adds and calibrations, added "
    "as squares."
)
FORMULA = re.compile(r": ([^:;.]{1,90}? = [^,;:.]{2,60})")


@dataclass(frozen=True)
class Sheet:
    """The two pages; texts are plain and may hold symbols (`F_ce`)."""

    item: str
    """Make and type."""
    about: str
    """Serial number and size."""
    sentence: str
    columns: list[tuple[str, list[str]]]
    """Tested, conditions, traceable to, model: a head and its lines."""
    table: ResultTable
    table_title: str
    also: list[tuple[str, str]]
    """Key values of other tests: symbol, value with its unit."""
    limits: list[tuple[str, str]]
    first: list[Picture]
    """Figures of page 1."""
    second: list[Picture]
    coverage: Coverage | None
    sources: Sources | None
    statistics: list[tuple[str, str]]
    checks: list[tuple[str, str, str]]
    findings: list[str]
    method: str
    seals: list[tuple[str, str]]
    """Run, and the hash of its seal, shortened."""
    used: list[str]
    """Names of the traces that are drawn here."""


def sheet_of(
    analyses: Sequence[Analysis],
    published: Sequence[Analysis],
    runs: Sequence[RunData],
    names: Mapping[str, str],
    verdict: Verdict,
    failed: Sequence[str],
) -> Sheet:
    """The sheet of `analyses`, with `published` values in its figures; `failed`: why results are not accepted."""
    tests = [drawable(a) for a in analyses if a.kind != AGREEMENT]
    table, members, over = result_table(tests)
    main = _main(tests, members)
    covered = coverage(main, runs) if main else None
    table = replace(table, notes=[*table.notes, *_counted(members, over, covered)])
    less = ROW / 2 * max(0, len(table.rows) + len(table.notes) - USUAL)
    pictures, used = _pictures([*analyses, *published], members, over, less)
    tiles = [tile for tile in tiles_of(analyses) if tile.symbol not in table.symbols]
    item, about = _item(runs)
    title = kind_title(main.kind) if main else ""
    return Sheet(
        item=item,
        about=about,
        sentence=_sentence(
            verdict, main, how_well(members, over) if members else "", [without_run(text, tests) for text in failed]
        ),
        columns=_columns(tests, main, runs),
        table=table,
        table_title=title,
        also=[(tile.symbol, f"{tile.value} {tile.unit}".strip()) for tile in tiles][:MOST_ALSO] if members else [],
        limits=quality.limits(main, tests, runs),
        first=pictures[:2],
        second=pictures[2:FIGURES],
        coverage=covered if covered and (covered.used or covered.left) else None,
        sources=sources(members, over) if members else None,
        statistics=quality.statistics(main) if main else [],
        checks=quality.checks(main) if main else [],
        findings=quality.findings(tests, failed),
        method=_method(main),
        seals=[
            (str(row["run"]), str(row["sha256 of seal.json"])[:16])
            for row in provenance.run_table(runs, names).rows
            if row.get("sha256 of seal.json")
        ],
        used=used,
    )


def _counted(members: Sequence[Estimate], over: str, covered: Coverage | None) -> list[str]:
    """A note where a trial counts at several operating points, as a stroke does."""
    n: dict[float, int] = {}
    for e in members:
        n[e.at[over]] = max(e.n, n.get(e.at[over], 0))
    passed = f"n: trials that passed this {spoken(over)}; one trial passes several"
    return [passed] if covered and sum(n.values()) > covered.used else []


def _main(tests: Sequence[Analysis], members: Sequence[Estimate]) -> Analysis | None:
    """The analysis whose values the table has; without a table the one with most values."""
    few = [replace(m, at={}) for m in members[:3]]
    if few:
        return max(tests, key=lambda a: sum(replace(e, at={}) == m for e in a.estimates for m in few))
    return max(tests, key=lambda a: sum(e.value is not None for e in a.estimates), default=None)


def _pictures(
    analyses: Sequence[Analysis], members: Sequence[Estimate], over: str, less: float
) -> tuple[list[Picture], list[str]]:
    """Up to three figures, and the traces in them: coefficients, force over contraction, a stroke; else others.

    The first two are lower by `less` [pt] each.
    """
    analyses = [_followed(drawable(a)) for a in analyses]
    found: list[Picture] = []
    used: list[str] = []
    across = sorted({name for e in members for name in e.at} - {over, "mass"})
    draw = partial(surface_picture, across=across[0]) if across else coefficient_picture
    several = len(across) > 1  # dots of all places would lie in a heap
    panels = draw(analyses, members, over, less=less) if members and not several else None
    found += [panels] if panels else []
    force = force_picture(analyses, less)
    found += [force] if force else []
    stroke = stroke_picture(analyses)
    if stroke is not None:
        found.append(stroke[0])
        used.append(stroke[1].name)
    if len(found) < FIGURES:
        more, traces = front_pictures(analyses, FIGURES, without=used)
        # a plot of one coefficient may be among the panels: `Stiffness K over pressure` in `stiffness K and ...`
        there = panels.title.lower() if panels else ""
        more = [one for one in more if panels is None or one.title.partition(" over ")[0].lower() not in there]
        place = len(found) - (stroke is not None)
        found[place:place] = more[: FIGURES - len(found)]
        used += traces
    return found[:FIGURES], used


def _followed(analysis: Analysis) -> Analysis:
    """Without free runs that end before half of their trial, where a coefficient is not known."""

    def whole(trace: Trace) -> bool:
        model = trace.columns.get("model") if trace.figure == "overlay" else None
        return model is None or float(np.isfinite(np.asarray(model, dtype=np.float64)).mean()) > 0.5

    return replace(analysis, traces=tuple(trace for trace in analysis.traces if whole(trace)))


def _item(runs: Sequence[RunData]) -> tuple[str, str]:
    """What was tested: make and type; serial and size."""
    known = provenance.specimens(runs)
    if not known:
        return "Pneumatic muscle", ""
    name, about = known[0]
    if name == provenance.UNNAMED:
        return capital(name), "type and serial number are not recorded"
    head, _, serial = name.partition(", serial ")
    size = [
        part
        for part in about.split(", ")
        if part and not part.startswith(("mounted", "braid")) and "cycles" not in part
    ]
    return head, ", ".join([f"serial {serial}"] * bool(serial) + size)


def _sentence(verdict: Verdict, main: Analysis | None, known: str, failed: Sequence[str]) -> str:
    """How well, in what range, what was left out; first of all why not, where it is not good."""
    parts = []
    if verdict.level != "good":
        why = brief(failed[0], 200) if failed else verdict.text.rstrip(".")
        parts.append(f"{capital(why)}.".replace("….", "…"))
    if known:
        parts.append(f"{known} (95 % intervals).")
    elif verdict.level == "good":
        parts.append(verdict.text)
    if main is not None and main.dropped:
        count = "1 trial is" if len(main.dropped) == 1 else f"{len(main.dropped)} trials are"
        parts.append(f"{count} left out: {left_out(main.dropped)}.")
    text = " ".join(part.replace("..", ".") for part in parts)
    return text if known else capital(text)


def _columns(tests: Sequence[Analysis], main: Analysis | None, runs: Sequence[RunData]) -> list[tuple[str, list[str]]]:
    """Four columns of short lines; one without a line is left out."""
    rates = sorted({run.rate for run in runs if run.rate})
    mounted = next((about for _, about in provenance.specimens(runs) if "mounted" in about), "")
    mounted = mounted[mounted.find("mounted") :].partition(" (")[0].partition(", ")[0]
    benches = [name for name, _ in provenance.benches(runs)]
    others = {0: "", 1: " and another bench"}.get(len(benches[1:]), f" and {len(benches[1:])} other benches")
    conditions = [f"{benches[0]}{others}"] if benches else []
    rate = f"sampled at {number(rates[0])} Hz" if len(rates) == 1 else ""
    conditions += [", ".join(part for part in (mounted, rate) if part)]
    when, who = provenance.when(runs), provenance.operators(runs)
    tested = [", ".join(kind_title(a.kind) if not n else kind_title(a.kind).lower() for n, a in enumerate(tests))]
    tested += [" by ".join(part for part in (when, who) if part)]
    model = described(main.estimates[0].method) if main and main.estimates else ""
    formula = FORMULA.search(model)
    fitted = [formula[1].strip()] if formula and formula[1].count("(") == formula[1].count(")") else []
    fitted += [f"method: {clean(main.estimates[0].method, 60)}"] if main and main.estimates else []
    found = {"Tested": tested, "Conditions": conditions, "Traceable to": _traceable(runs), "Model": fitted}
    return [(head, kept) for head, lines in found.items() if (kept := [clean(line, 160) for line in lines if line])]


def _traceable(runs: Sequence[RunData]) -> list[str]:
    """Calibrations of the measured channels, each once; what has none is named."""
    measured = [c for run in runs for c in run.channels.values() if not c.name.endswith("_command")]
    with_one = dict.fromkeys(f"{clean(c.name, 40)}: {clean(c.calibration, 40)}" for c in measured if c.calibration)
    without = dict.fromkeys(clean(c.name, 40) for c in measured if not c.calibration)
    lines = list(with_one)[:4]
    return lines + ([f"no calibration: {', '.join(list(without)[:4])}"] if without else [])


def _method(main: Analysis | None) -> str:
    """How the numbers were got, in few sentences, and one on U."""
    if main is None or not main.estimates:
        return ""
    text = brief(described(main.estimates[0].method), MOST_LETTERS)
    return f"{text}{'' if text.endswith(('.', '…')) else '.'} {INTERVALS}"
