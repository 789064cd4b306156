"""What the last diagnosis of this bench or this specimen found, in words for whoever tests next; computes nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pmabench.base.errors import InvalidFile, RecordError
from pmabench.base.text import clean
from pmabench.cli.history import ANALYSES
from pmabench.cli.names import short

if TYPE_CHECKING:
    from pmabench.bench.compile import Mounted

MOST = 3
"""Lines that are printed."""
NEWEST = 40
"""Analyses that are looked at, the newest first."""
LONGEST = 400
SURE = ("sound", "corrected", "doubtful")
"""States of a diagnosis that names what it found; in others a name may be wrong, and nobody should look for it."""
DESCRIBE = "pmabench campaign real-muscle and process --form surface describe it"


def last_words(mounted: Mounted, runs: Path) -> list[str]:
    """At most three lines from the newest analysis with a diagnosis: of this bench its faults, of this specimen itself.

    Looked for in the folder `analyses` next to the folder of runs; one that found nothing ends the search without a
    line, and simulated runs say nothing about a real bench.
    """
    asked = {"bench": mounted.bench.name, "specimen": (mounted.specimen_file.type, mounted.specimen_file.serial)}
    lines: list[str] = []
    for folder, form, manifest in _diagnosed(runs):
        if bool(manifest.get("simulated")) is mounted.bench.realtime:
            continue
        specimen = manifest.get("specimen")
        mine = (specimen.get("type"), specimen.get("serial")) if isinstance(specimen, Mapping) else None
        same = {"bench": manifest.get("bench") == asked["bench"], "muscle": mine == asked["specimen"]}
        for of, what in (("bench", "bench"), ("muscle", "specimen")):
            if same[of] and what in asked:
                del asked[what]
                lines += _lines(form, of, f"last diagnosis of this {what} ({_place(folder)})")
        if not asked:
            break
    return lines[:MOST]


def _lines(form: Mapping[str, Any], of: str, head: str) -> list[str]:
    """What a diagnosis says of the bench, or of the muscle."""
    if form.get("state") not in SURE:
        return [f"{head}: it did not follow straight lines, and why is undecided; {DESCRIBE}"] if of == "muscle" else []
    found = [one for one in form["explanations"] if isinstance(one, Mapping) and one.get("of") == of]
    lines = [f"{head}: {clean(one.get('text', ''), LONGEST)}. {_sentence(one.get('advice', ''))}" for one in found]
    if of == "muscle" and lines:
        lines[-1] += f"; {DESCRIBE}"
    return lines


def _sentence(text: Any) -> str:
    words = clean(text, LONGEST)
    return words[:1].upper() + words[1:]


def _diagnosed(runs: Path) -> Iterator[tuple[Path, Mapping[str, Any], Mapping[str, Any]]]:
    """Folder, diagnosis, and manifest of the last run, of analyses that have one, the newest first."""
    from pmabench.store.analyses.folder import read_analysis, runs_of
    from pmabench.store.folder import read_manifest

    parent = runs.resolve().parent if runs.resolve().name == "runs" else runs
    files = {path for pattern in ANALYSES for path in (parent / "analyses").glob(pattern)}
    for path in sorted(files, key=lambda path: path.stat().st_mtime_ns, reverse=True)[:NEWEST]:
        try:
            facts = read_analysis(path.parent).facts
            form = facts.get("form")
            if not isinstance(form, Mapping) or not isinstance(form.get("explanations"), list):
                continue
            if facts.get("recalibrated"):
                continue  # what was taken off the record is still wrong at the bench
            if folders := runs_of(path.parent):
                yield path.parent, form, read_manifest(folders[-1])
        except (InvalidFile, RecordError, OSError):
            continue  # `check` is not about analyses: who opens it learns what is wrong with it


def _place(folder: Path) -> str:
    """The analyses of the same runs, as they are shortest typed here."""
    return short(folder.parent)
