"""A paragraph on methods that can be pasted into a paper, and how to cite the report; computes nothing."""

from __future__ import annotations

import re
from collections.abc import Sequence

from pmabench import __version__
from pmabench.analysis.results import AGREEMENT, Analysis
from pmabench.plotting.wording import clean
from pmabench.report.document import provenance
from pmabench.report.words.method_words import described
from pmabench.report.words.names import kind_title
from pmabench.store.records import RunData


def methods_paragraph(analyses: Sequence[Analysis], runs: Sequence[RunData]) -> str:
    """Specimen, bench, each test with its points, the primary method of each, what was left out."""
    sentences = []
    for name, about in provenance.specimens(runs):
        sentences.append(f"The specimen was a {name}" + (f" ({about})" if about else "") + ".")
    for name, about in provenance.benches(runs):
        sentences.append(f"It was tested on the bench “{name}”" + (f" ({about})" if about else "") + ".")
    if any(a.simulated for a in analyses) or any(run.simulated for run in runs):
        alone = all(a.simulated for a in analyses) and all(run.simulated for run in runs)
        sentences.append(f"{'All' if alone else 'Some'} of the tests are simulated; no real muscle moved in them.")
    for row in provenance.protocol_table(runs, {}).to_dict("records"):
        points = f" at {row['operating points']}" if row["operating points"] else ""
        rate = f", sampled at {row['rate']}" if row["rate"] else ""
        sentences.append(f"{row['test']}, protocol “{row['protocol']}”{points}{rate}; {row['trials']} trials finished.")
    seen: set[str] = set()
    for analysis in (a for a in analyses if a.kind != AGREEMENT and a.estimates):
        method = analysis.estimates[0].method
        how = described(method)
        named = f"{kind_title(analysis.kind)} was evaluated by the method “{clean(method, 120)}”"
        sentences.append(f"{named}: {how.rstrip('.')}." if how and method not in seen else f"{named}.")
        seen.add(method)
    dropped = sum(len(a.dropped) for a in analyses)
    if any(e.ci95 for a in analyses for e in a.estimates):
        sentences.append(
            "Intervals are 95 % intervals: the scatter between trials, what the estimator itself adds and the "
            "calibration of the channels, added as squares as far as each was assessed."
        )
    if dropped:
        sentences.append(f"{dropped} trials did not enter a fit; the report lists each with its reason.")
    sentences.append(f"Tests were run and evaluated with pmabench {__version__}.")
    return clean(" ".join(sentences), 12_000)


def citation(title: str, report_id: str, when: str, simulated: bool) -> tuple[str, str]:
    """How to cite the report: one line, and the same as a BibTeX entry."""
    year = when[-10:-6] if re.fullmatch(r"\d{4}", when[-10:-6]) else ""
    note = f"report {report_id}, pmabench {__version__}" + (", simulated" if simulated else "")
    line = f"{title}. Characterisation {note}{', ' + when if when else ''}."
    fields = {"title": _tex(title), "note": _tex(note[:1].upper() + note[1:])} | ({"year": year} if year else {})
    body = ",\n".join(f"  {name} = {{{text}}}" for name, text in fields.items())
    return line, f"@misc{{pmabench-{report_id},\n{body}\n}}"


def _tex(text: str) -> str:
    from pmabench.report.files.latex import escaped

    return escaped(text)
