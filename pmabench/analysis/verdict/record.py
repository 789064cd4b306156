"""What the record of runs says against their results: open questions, kept files that changed, doubts; fits nothing.

An import stores questions that nobody answered, a bench what its files seem to have wrong (another muscle than the
simulated one). Every analysis of such runs repeats it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from pmabench.analysis.results import Analysis, Finding
from pmabench.base.text import printable
from pmabench.store.records import RunData

LONGEST = 1000
"""Characters of a sentence from a record, which may be another's."""
REMEDY = "write the answer into the map, import again and process the new run"


def with_record(analysis: Analysis, runs: Sequence[RunData]) -> Analysis:
    """The analysis with the doubts of the runs' records as findings and with what refuses its acceptance."""
    doubts = [(run.id, str(doubt)) for run in runs for doubt in run.manifest.get("doubts") or ()]
    findings = tuple(Finding("doubt", text) for text in _counted(doubts))
    refusals = (*_unanswered(analysis.kind, runs), *_altered(runs))
    return replace(analysis, findings=(*analysis.findings, *findings), refusals=(*analysis.refusals, *refusals))


def _unanswered(kind: str, runs: Sequence[RunData]) -> Iterator[str]:
    """One sentence for each question that was open when the runs were imported."""
    questions = [(run.id, _sentence(each)) for run in runs for each in unresolved_of(run)]
    for text in _counted(questions):
        yield f"{kind}: not answered: {text}"


def unresolved_of(run: RunData) -> Iterator[Mapping[str, object]]:
    """The questions that were open when a run was imported, as its manifest holds them."""
    imported = run.manifest.get("imported")
    entries = imported.get("unresolved") if isinstance(imported, Mapping) else None
    for entry in entries if isinstance(entries, list | tuple) else ():
        if isinstance(entry, Mapping) and {"what", "question"} <= set(entry):
            yield entry


def _sentence(entry: Mapping[str, object]) -> str:
    used = f"; taken here: {entry['used']}" if entry.get("used") else ""
    where = f" ({entry['where']})" if entry.get("where") else ""
    return f"{entry['what']}: {entry['question']}{used}{where}; {REMEDY}"


def _altered(runs: Sequence[RunData]) -> Iterator[str]:
    consequence = "the results come from the samples, which are whole; what they were made of can no longer be checked"
    for run in runs:
        for fault in run.since.altered:
            yield f"{run.id}: {fault}: {consequence}; bring the file back, or import it again"


def _counted(sentences: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Each text once, with the run that says it, or how many do."""
    runs: dict[str, list[str]] = {}
    for run, text in sentences:
        runs.setdefault(text, []).append(run)
    for text, names in runs.items():
        many = dict.fromkeys(names)
        shown = printable(text, LONGEST)
        yield f"{names[0]}: {shown}" if len(many) == 1 else f"{len(many)} runs: {shown}"
