"""Converts old files to runs: one run per test, with the file inside it; faults are reported and flagged.

All files are read and checked before anything is written, and after a failure everything written is removed. Files of
one call at the same operating point are compared, which may show faults that a single file does not show.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from pmabench.base.errors import InvalidFile, Problem, invalid
from pmabench.base.kind import Imported
from pmabench.base.quantities import CHANNEL_QUANTITY, show
from pmabench.store.folder import PLAN, Copy, run_name
from pmabench.store.importers import plausible
from pmabench.store.importers.commands import alike
from pmabench.store.importers.found import Found, Summary
from pmabench.store.importers.map_file import Question
from pmabench.store.importers.map_rules import ImportMap, read_map
from pmabench.store.importers.prepare import Prepared, placed, prepare_all
from pmabench.store.records import Flag
from pmabench.store.writer import RunWriter

ALIKE = 1.3
"""Largest ratio of slopes of repeats."""
UNIT_FACTORS: Mapping[str, Mapping[str, float]] = {
    "force": {"kilograms for newtons": 9.80665, "pounds for newtons": 4.4482, "a factor of 1000": 1000.0},
    "pressure": {"psi for kPa": 6.8948, "bar for kPa": 100.0, "a factor of 10": 10.0, "a factor of 1000": 1000.0},
    "length": {"inches for mm": 25.4, "a factor of 10": 10.0, "a factor of 1000": 1000.0},
}


def compare(files: Sequence[Summary], allowed: Mapping[str, float]) -> list[list[Found]]:
    """Findings per file about differences from its siblings, the files at the same operating point.

    `allowed`: channel -> largest relative difference of peaks [1]. With three or more files the median shows which is
    wrong (`fault`); of two trusted files either may be (`doubt`).
    """
    found: list[list[Found]] = [[] for _ in files]
    for index, file in enumerate(files):
        siblings = [other for other in files if other.point == file.point and other is not file]
        trusted = [other for other in siblings if other.trusted]
        for channel, share in allowed.items():
            others = [other.peaks[channel] for other in trusted if channel in other.peaks]
            if channel not in file.peaks or not others:
                continue
            peaks = [*others, file.peaks[channel]] if file.trusted else others
            usual = float(np.median(peaks if len(peaks) > 2 else others))
            ratio = file.peaks[channel] / usual if usual else float("inf")
            if abs(ratio - 1.0) <= share:
                continue
            sure = len(peaks) > 2 or not file.trusted
            quantity = CHANNEL_QUANTITY[channel]
            text = f"{channel}: peak {show(file.peaks[channel], quantity, 4)}, that of its siblings "
            text += f"{show(usual, quantity, 4)}: implausible{_hint(ratio, quantity)}"
            text += "" if sure else "; which of the two is wrong is not known"
            found[index].append(Found("fault" if sure else "doubt", "sibling", text, channel))
        found[index] += _steeper(file, trusted)
    return found


def _steeper(file: Summary, others: Sequence[Summary]) -> list[Found]:
    """Finding for files at one point whose slopes differ too much for repeats: all are withheld."""
    slopes = [each.slope for each in (file, *others) if each.slope]
    if not file.slope or not file.trusted:
        return []
    usual = float(np.median(slopes))
    if usual != 0.0 and all(1.0 / ALIKE <= slope / usual <= ALIKE for slope in slopes):
        return []
    low, high = (show(end(slopes), "force per pressure", 4) for end in (min, max))
    text = f"force: slopes over pressure of the files at its point are {low} to {high}: these are no repeats of one "
    text += "test, for a unit or a scale differs, or the contraction"
    return [Found("fault", "sibling", text, "force", withholds=True)]


def _hint(ratio: float, quantity: str) -> str:
    if ratio <= 0:
        return ", the sign may be wrong"
    factors = UNIT_FACTORS.get(quantity, {}).items()
    likely = (text for text, factor in factors if min(abs(ratio / factor - 1.0), abs(ratio * factor - 1.0)) < 0.03)
    return next((f" (is it {text}?)" for text in likely), "")


MOST_FILES = 10_000


@dataclass(frozen=True)
class ImportedRun:
    """A run made from an old file."""

    path: Path
    """Folder of the run."""
    id: str
    source: Path
    kind: str
    rows: int
    trials: int
    findings: tuple[Found, ...]
    flagged: Mapping[str, int]
    """Name of the flag in lower case -> number of samples."""
    unresolved: tuple[Question, ...] = ()
    """Open questions of the map."""


def import_files(
    files: Sequence[Path],
    map_path: Path,
    out: Path,
    kinds: Mapping[str, Imported],
    answers: Sequence[tuple[str, str]] = (),
    *,
    unresolved: bool = False,
) -> list[ImportedRun]:
    """Make one run below `out` of each test in the files, according to the map; the files are not changed.

    `kinds`: what each kind of test needs from a file. `answers` and `unresolved`: for the questions of the map, as in
    `read_map`. Raises InvalidFile with the problems of the map, or else of all files, and then leaves nothing behind.
    Peaks of the files are compared where the map has `siblings`.
    """
    rules = read_map(map_path, kinds, answers, unresolved=unresolved)
    if not files or len(files) > MOST_FILES:
        raise invalid(map_path, f"is for 1 to {MOST_FILES} files at a time, {len(files)} were given")
    prepared, summaries, hashes = _read_all(files, rules)
    found = compare(summaries, {str(channel): share for channel, share in rules.file.siblings.items()})
    among = iter([plausible.answered(each, rules.file.confirmed) for each in found])
    measured = [pair for summary in summaries for pair in summary.measured]
    levels = {name: alike(name, [value for of, value in measured if of == name]) for name, _ in measured}
    made: list[ImportedRun] = []
    existed = out.exists()
    try:
        for path, digest in zip(files, hashes, strict=True):
            if len(files) > 1:
                prepared = prepare_all(path, rules)
            for each in prepared:
                if each.table.sha256 != digest:
                    raise invalid(path, "was changed while it was read")
                parts = tuple(part.at_levels(levels) for part in each.parts)
                made.append(_write(replace(each, parts=parts), rules, next(among), out))
    except BaseException:
        for run in made:
            shutil.rmtree(run.path, ignore_errors=True)
        if not existed:
            with suppress(OSError):
                out.rmdir()
        raise
    return made


def _read_all(files: Sequence[Path], rules: ImportMap) -> tuple[list[Prepared], list[Summary], list[str]]:
    """The tests of the last file, a summary of every test, and each file's sha256; InvalidFile with all problems."""
    problems, summaries, prepared = list[Problem](), list[Summary](), list[Prepared]()
    first: dict[str, Path] = {}
    for path in files:
        try:
            prepared = prepare_all(path, rules)
        except InvalidFile as error:
            problems.extend(error.problems)
            continue
        summaries += [each.summary for each in prepared]
        digest = prepared[0].table.sha256
        if digest in first:
            problems.append(Problem(str(path), 0, 0, f"holds the same bytes as {first[digest]}"))
        first.setdefault(digest, path)
    if problems:
        raise InvalidFile(problems)
    return prepared, summaries, list(first)


def _write(prepared: Prepared, rules: ImportMap, apart: Sequence[Found], out: Path) -> ImportedRun:
    """Write one run from one prepared test; removes it again if that fails."""
    wrong = any(found.level == "fault" and not found.withholds for found in apart)
    flags = prepared.flags | np.uint16(Flag.SUSPECT if wrong else Flag.OK)
    findings = (*prepared.findings, *(placed(found, prepared.t, len(prepared.table)) for found in apart))
    counts = {str(flag.name).lower(): int(np.count_nonzero(flags & np.uint16(flag))) for flag in Flag}
    flagged = {name: count for name, count in counts.items() if count}
    started = prepared.named.started or datetime.now(UTC)
    title = f"{rules.file.specimen.type}-{rules.file.specimen.serial}"
    name = run_name(started, title, rules.file.kind, simulated=prepared.simulated)
    manifest = _manifest(prepared, rules, findings, flagged, started)
    writer = RunWriter.create(out, name, manifest, _snapshots(prepared, rules))
    writer.waits = True
    try:
        columns = [channel.rule.record(channel.rule.role in prepared.whole) for channel in prepared.checked]
        writer.open_stream("file", columns, 1.0 / prepared.period if prepared.period > 0 else 0.0)
        begin = 0
        for t, checked in prepared.blocks():
            raw = {c.rule.role: c.raw.astype(np.int32) if c.rule.role in prepared.whole else c.raw for c in checked}
            writer.append_now("file", np.round(t * 1e9).astype(np.int64), raw, flags[begin : begin + len(t)])
            begin += len(t)
        _events(writer, prepared)
        writer.close("finished")
    except BaseException:
        with suppress(Exception):
            writer.close("error", "the import failed")
        shutil.rmtree(writer.folder, ignore_errors=True)
        raise
    return ImportedRun(
        path=writer.folder,
        id=writer.folder.name,
        source=prepared.table.path,
        kind=rules.file.kind,
        rows=len(prepared.table),
        trials=len(prepared.parts),
        findings=findings,
        flagged=flagged,
        unresolved=prepared.questions,
    )


def _events(writer: RunWriter, prepared: Prepared) -> None:
    for index, part in enumerate(prepared.parts):
        known = {"point": dict(part.point), "repeat": prepared.named.test, "reference": False}
        writer.event("trial-begin", part.begin, trial=index, **known)
        lines: list[tuple[str, Mapping[str, Any]]] = [("command", command) for command in part.commands]
        lines += [("phase", {"t": at, "name": name}) for at, name in part.phases]
        lines += [("found", found) for found in part.found]
        for kind, data in sorted(lines, key=lambda line: float(line[1]["t"])):
            writer.event(kind, trial=index, **data)
        writer.event("trial-end", part.end, trial=index, status="finished")


def _snapshots(prepared: Prepared, rules: ImportMap) -> dict[str, bytes | Copy]:
    """Files to keep in the run: the source, its notes, the map with its included files, and the plan."""
    table = prepared.table
    kept: dict[str, bytes | Copy] = {f"source/{_legal(table.path.name)}": Copy(table.path, table.sha256)}
    if prepared.notes is not None:
        kept[f"source/notes-{_legal(prepared.notes[0])}"] = prepared.notes[1]
    for number, (path, text) in enumerate(rules.texts.items()):
        kept["map.yaml" if path == rules.path else f"map-included-{number}.yaml"] = text.encode()
    if rules.file.settings:
        plan = rules.file.model_dump(include={"settings"})
        kept[PLAN] = (json.dumps(plan, indent=1, sort_keys=True) + "\n").encode()
    return kept


def _legal(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]", "-", name)[-100:].lstrip("._-") or "file"


def _manifest(
    prepared: Prepared, rules: ImportMap, findings: Sequence[Found], flagged: Mapping[str, int], started: datetime
) -> dict[str, Any]:
    table = prepared.table
    notes = prepared.notes[1].decode("utf-8", "replace") if prepared.notes is not None else ""
    lines = [{**vars(each), "line": None if each.index is None else table.line(each.index)} for each in findings]
    return {
        "kind": rules.file.kind,
        "protocol": rules.file.name,
        "source": rules.file.source,
        "simulated": prepared.simulated,
        "started_utc": started.isoformat(timespec="milliseconds"),
        "operator": "",
        "bench": rules.file.bench,
        "specimen": rules.file.specimen.model_dump(mode="json"),
        "trials_planned": len(prepared.parts),
        "imported": {
            "file": table.path.name,
            "folder": table.path.resolve().parent.name,
            "sha256": table.sha256,
            "bytes": table.size,
            "rows": len(prepared.table),
            **({"test": prepared.name} if prepared.name else {}),
            "started_known": prepared.named.started is not None,
            "map": Path(rules.path).name,
            "map_sha256": hashlib.sha256("".join(rules.texts.values()).encode()).hexdigest(),
            "notes": notes,
            "findings": lines,
            "flagged": dict(flagged),
            "late_by": {c.rule.role: list(c.rule.late_by) for c in prepared.checked if any(c.rule.late_by)},
            "analysis": rules.file.analysis.model_dump(mode="json"),
            "unresolved": [vars(question) for question in prepared.questions],
        },
    }
