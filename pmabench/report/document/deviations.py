"""What did not go as the protocol says, what people noted, and what a test report by ISO/IEC 17025 has or lacks.

Deviations in the record of each run are a sentence each; notes come with their pictures. Manifests are untrusted and
everything in them is optional; nothing here raises for what is missing or odd.

The checklist is ISO/IEC 17025:2017, 7.8.2 and 7.8.3, in our own words. No run holds a laboratory's name, its customer
and who authorises: whoever writes the report gives them (`Issuer`). Nothing here says that a laboratory is accredited.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pmabench.plotting.wording import clean, number
from pmabench.report.document.provenance import get, text_of
from pmabench.store.analyses.results import Analysis
from pmabench.store.folder import open_regular
from pmabench.store.records import RunData

RATE_OFF = 0.01
"""Share by which a sample rate differs from the planned one before it is reported."""


def deviations(runs: Sequence[RunData], names: Mapping[str, str]) -> list[str]:
    """What did not go as the protocol says, and what the bench lacks, a sentence each, with the runs in front."""
    lines: dict[str, list[str]] = {}
    for run in runs:
        for text in [*_recorded(run), *_trials(run), *_samples(run), *_end(run)]:
            lines.setdefault(clean(text, 500), []).append(names.get(run.id, "?"))
    return [f"{', '.join(where)}: {text}" for text, where in lines.items()]


def _recorded(run: RunData) -> Iterator[str]:
    """Deviations that the recording program noted itself."""
    if run.status != "finished":
        why = text_of(run.manifest.get("why"))
        yield f"ended “{run.status}”" + (f": {why}" if why else "")
    for key, words in (("deviations", ""), ("hazards", "hazard: "), ("lacks", "the bench lacks: ")):
        entries = run.manifest.get(key)
        for item in entries if isinstance(entries, list | tuple) else [entries] if entries else []:
            yield f"{words}{text_of(item)}"


def _trials(run: RunData) -> Iterator[str]:
    """Trials that ended otherwise, are missing, came twice or in another order, or are excluded by a note."""
    count = Counter(trial.status for trial in run.trials if trial.status != "finished")
    if count:
        yield "trials: " + ", ".join(f"{n} {status}" for status, n in count.items())
    planned = run.manifest.get("trials_planned")
    kept = {trial.index for trial in run.trials if trial.status in ("finished", "excluded")}
    if isinstance(planned, int) and not isinstance(planned, bool) and len(kept) < planned:
        yield f"{planned - len(kept)} of {planned} planned trials are not finished"
    again = [str(trial.number) for trial in run.trials if trial.attempt > 1]
    if again:
        yield f"begun again: trial{'s' if len(again) > 1 else ''} {', '.join(again[:12])}"
    in_time = sorted(run.trials, key=lambda trial: float(trial.t[0]) if len(trial.t) else float("inf"))
    begun = [trial.index for trial in in_time if trial.attempt == 1 and not trial.again]
    if begun != sorted(begun):
        yield "trials were not done in the planned order"
    for note in run.notes:
        if note.exclude is not None:
            yield f"trial {note.excluded} is left out by {clean(note.operator, 120)}: {clean(note.because, 300)}"


def _samples(run: RunData) -> Iterator[str]:
    """Flagged samples, another rate than planned, channels that are missing."""
    for counts in (get(run.manifest, "end", "counts"), get(run.manifest, "imported", "flagged")):
        for name, n in counts.items() if isinstance(counts, Mapping) else ():
            if name not in ("rows", "slack") and isinstance(n, int) and n > 0:
                yield f"samples flagged {text_of(name)}: {n}"
    planned = run.plan.get("rate")
    rates = [1 / dt for trial in run.trials if len(trial.t) > 2 and (dt := float(np.median(np.diff(trial.t)))) > 0]
    if isinstance(planned, int | float) and planned > 0 and rates:
        rate = float(np.median(rates))
        if abs(rate / planned - 1) > RATE_OFF:
            yield f"sampled at {number(rate)} Hz; {number(planned)} Hz was planned"
    wanted = run.plan.get("record")
    lacking = [name for name in wanted if isinstance(name, str)] if isinstance(wanted, list | tuple) else []
    lacking = [clean(name, 60) for name in lacking if run.trials and not any(name in t.channels for t in run.trials)]
    if lacking:
        yield f"planned but not recorded: {', '.join(lacking)}"
    for channel, how in run.interpolated.items():
        yield f"{text_of(channel)}: {how}"


def _end(run: RunData) -> Iterator[str]:
    """Prompts that nobody answered, a vent by the guard, and an end without a confirmed safe state."""
    answered = sum(e.kind == "answer" and "--yes" in str(e.data.get("answer", "")) for e in run.events)
    if answered:
        yield f"prompts to the operator confirmed beforehand (--yes): {answered}"
    if run.manifest.get("guard"):
        result = text_of(get(run.manifest, "guard", "vent", "result"))
        yield f"the program died; the guard vented the bench after that: {result}"
    vent = get(run.manifest, "end", "vent", "result")
    if vent not in (None, "confirmed"):
        yield f"the safe state at the end was {text_of(vent)}"
    yield from run.since.sentences


KINDS = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}
"""Pictures are known by how their bytes begin, not by their names."""
LARGEST = 5_000_000
"""Bytes of a picture; a larger one is only named."""
MOST = 40_000_000
"""Bytes of all pictures of a page."""


@dataclass(frozen=True)
class Said:
    """What somebody noted during a run, with the files attached to it."""

    run: str
    """Short name of the run."""
    utc: str
    operator: str
    text: str
    pictures: tuple[tuple[str, str], ...]
    """Name and data URI."""
    files: tuple[str, ...]
    """Attached files that are not shown."""


def notes_of(runs: Sequence[RunData], names: Mapping[str, str]) -> list[Said]:
    """Every note of every run; `names` are the short names of runs."""
    left = MOST
    found = []
    for run in runs:
        for note in run.notes:
            words = [note.text] if note.text else []
            if note.exclude is not None:
                words.append(f"Trial {note.excluded} is left out: {note.because}")
            pictures, others = [], []
            for file in note.files:
                data = _picture(Path(run.path) / file, min(LARGEST, left))
                left -= len(data)
                name = clean(file.rpartition("/")[2], 120)
                if data:
                    pictures.append((name, data))
                else:
                    others.append(name)
            text = clean(". ".join(words), 2000)
            who = clean(note.operator, 120)
            when = clean(note.utc, 40)[:16].replace("T", " ")
            found.append(Said(names.get(run.id, "?"), when, who, text, tuple(pictures), tuple(others)))
    return found


def _picture(path: Path, most: int) -> str:
    """The file as a data URI; empty where it is no picture that a page can show, or too large."""
    try:
        with open_regular(path) as file:
            raw = file.read(most + 1)
        if len(raw) > most:
            return ""
    except (OSError, ValueError):
        return ""
    kind = next((kind for begin, kind in KINDS.items() if raw.startswith(begin)), "")
    return f"data:{kind};base64,{base64.b64encode(raw).decode()}" if kind else ""


@dataclass(frozen=True)
class Issuer:
    """Who issues the report; empty where it was not given."""

    laboratory: str = ""
    """Name and address."""
    customer: str = ""
    authorised_by: str = ""
    issued: str = ""
    """Date of issue."""

    def cleaned(self) -> Issuer:
        """The same without control characters and cut to a line."""
        return Issuer(*(clean(text, 300) for text in vars(self).values()))


@dataclass(frozen=True)
class Item:
    """One line of the checklist."""

    clause: str
    asked: str
    there: bool
    said: str
    """Where it is, or what to do."""


def checklist(
    analyses: Sequence[Analysis],
    runs: Sequence[RunData],
    issuer: Issuer,
    *,
    specimen: str,
    when: str,
    deviations: Sequence[str],
    accepted: bool,
) -> list[Item]:
    """Every clause that applies to tests; sampling (7.8.5) and calibration certificates (7.8.4) do not."""
    estimates = [e for a in analyses for e in a.estimates if e.value is not None]
    without = sum(e.ci95 is None for e in estimates)
    measured = {c for run in runs for c in run.channels.values() if not c.name.endswith("_command")}
    uncalibrated = sorted({clean(c.name, 40) for c in measured if not c.calibration})
    lacking = f"without calibration: {', '.join(uncalibrated)}" if uncalibrated else "the runs are not at hand"

    def of_all(*names: str) -> bool:
        return bool(runs) and all(any(get(run.manifest, *name.split(".")) for name in names) for run in runs)

    def given(option: str) -> str:
        return f"not given; use {option}, or write it by hand"

    rows = (
        ("7.8.2.1 a", "a title", True, "first page", ""),
        ("7.8.2.1 b, c", "the laboratory, its address, where it was tested", issuer.laboratory, issuer.laboratory,
         given("--laboratory")),
        ("7.8.2.1 d", "an identification on every page", True, "the report's number, on each page", ""),
        ("7.8.2.1 e", "the customer", issuer.customer, issuer.customer, given("--customer")),
        ("7.8.2.1 f", "the method", of_all("source", "protocol"), "Protocol, Methods",
         "name the source in the protocol"),
        ("7.8.2.1 g", "the item, unmistakably", specimen, specimen, "give make, type and serial number"),
        ("7.8.2.1 g", "its condition", of_all("specimen.mounted"), "first page",
         "give the specimen's `mounted` in its file"),
        ("7.8.2.1 i", "dates of the tests", when, when, "the runs are not at hand"),
        ("7.8.2.1 j", "date of issue", issuer.issued, issuer.issued, given("--issued")),
        ("7.8.2.1 l", "“relates only to the items tested”", True, "Provenance", ""),
        ("7.8.2.1 m", "results with units", estimates, "first page, All values", "there is no result"),
        ("7.8.2.1 n", "deviations, additions, exclusions", runs,
         f"{len(deviations)} remarks under Protocol and deviations", "the runs are not at hand"),
        ("7.8.2.1 o", "who authorises the report", issuer.authorised_by, issuer.authorised_by,
         given("--authorised-by")),
        ("7.8.3.1 a", "test conditions", of_all("session"), "warm-up, self-test and zeros: session of each run",
         "no session with zeros and supply is in the record; room temperature and supply are not known"),
        ("7.8.3.1 b", "conformity, where it is asked for", True,
         "first page" if accepted else "not asked for: the protocols set no acceptance limits (`accept`)", ""),
        ("7.8.3.1 c", "measurement uncertainty", estimates and not without, "Intervals in parts",
         f"{without} of {len(estimates)} values have no interval; Intervals in parts says why"),
        ("6.5", "calibrations of the channels", runs and not uncalibrated, "Provenance", lacking),
    )  # fmt: skip
    return [Item(clause, asked, bool(there), said if there else todo) for clause, asked, there, said, todo in rows]
