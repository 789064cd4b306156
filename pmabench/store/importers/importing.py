"""Old files to runs: one run per file, the file itself kept inside it, what is wrong told and flagged.

All files are read and checked before anything is written; what is written before a failure is taken away again.
"""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from pmabench.base.errors import InvalidFile, Problem, invalid
from pmabench.store.importers import plausible, quality, siblings, units
from pmabench.store.importers.found import Checked, Found, plain
from pmabench.store.importers.magnitude import Muscle, slope_of
from pmabench.store.importers.map_rules import ColumnRule, ImportMap, NameRule, read_map
from pmabench.store.importers.order import pressure_late
from pmabench.store.importers.segments import Segment, segments
from pmabench.store.importers.siblings import Summary
from pmabench.store.importers.table import Table, read_table
from pmabench.store.naming import run_name
from pmabench.store.records import UNUSABLE, Array, Flag, Flags
from pmabench.store.writer import RunWriter

NOTES_BYTES = 100_000
FOLLOWS = {
    "isometric": "force",
    "recorded-pull": "force",
    "recorded-step": "displacement",
    "recorded-sine": "displacement",
}
"""Kind of run -> channel that rises with pressure."""
MOST_FILES = 10_000


@dataclass(frozen=True)
class ImportedRun:
    """One old file that became a run."""

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


@dataclass(frozen=True)
class _Named:
    """What the name of a file says."""

    point: Mapping[str, float]
    test: int
    started: datetime | None


@dataclass(frozen=True)
class _Prepared:
    """One file, read and checked."""

    table: Table
    named: _Named
    t: Array
    checked: tuple[Checked, ...]
    flags: Flags
    findings: tuple[Found, ...]
    parts: tuple[Segment, ...]
    notes: tuple[str, bytes] | None
    held: bool
    """The muscle was held at a length: its force follows pressure."""
    questions: tuple[Mapping[str, str], ...]
    """What changes numbers and cannot be decided: `what`, `where`, `question`."""


def import_files(files: Sequence[Path], map_path: Path, out: Path) -> list[ImportedRun]:
    """Make one run below `out` of each file, as the map at `map_path` says; the files themselves are never touched.

    Raises InvalidFile with the problems of the map, or else of all files, and leaves nothing behind then. Files of one
    call are compared with each other where the map names `siblings`.
    """
    rules = read_map(map_path)
    if not files or len(files) > MOST_FILES:
        raise invalid(map_path, f"is for 1 to {MOST_FILES} files at a time, {len(files)} were given")
    problems: list[Problem] = []
    summaries: list[Summary] = []
    hashes: list[str] = []
    for path in files:
        try:
            prepared = prepare(path, rules)
        except InvalidFile as error:
            problems.extend(error.problems)
            continue
        summaries.append(_summary(prepared))
        hashes.append(prepared.table.sha256)
    if not problems:
        problems = [
            Problem(str(path), 0, 0, f"holds the same bytes as {files[hashes.index(digest)]}")
            for number, (path, digest) in enumerate(zip(files, hashes, strict=True))
            if hashes.index(digest) != number
        ]
    if problems:
        raise InvalidFile(problems)
    among = [plausible.answered(found, rules.confirmed) for found in siblings.compare(summaries, rules.siblings)]
    made: list[ImportedRun] = []
    existed = out.exists()
    try:
        for path, digest, apart in zip(files, hashes, among, strict=True):
            prepared = prepare(path, rules)
            if prepared.table.sha256 != digest:
                raise invalid(path, "was changed while it was read")
            made.append(_write(prepared, rules, apart, out))
    except BaseException:
        for run in made:
            shutil.rmtree(run.path, ignore_errors=True)
        if not existed:
            with suppress(OSError):
                out.rmdir()
        raise
    return made


def prepare(path: Path, rules: ImportMap) -> _Prepared:
    """Read, scale and check one file."""
    wanted = [column.column for column in rules.columns if not column.optional]
    optional = [column.column for column in rules.columns if column.optional]
    table = read_table(path, rules.layout, wanted, optional, rules.ignored)
    units.agree(path, rules.columns, table.units)
    named = _named(path, rules, table.started)
    time = next(column for column in rules.columns if column.role == "time")
    t = table.columns[time.column] * time.slope
    if np.isnan(t).any() or np.abs(t).max() > 9e9:
        row = int(np.argmax(~(np.abs(t) <= 9e9)))
        raise invalid(path, "a row has no time, or one out of all range", int(table.lines[row]), 1)
    checked = tuple(_checked(table, column) for column in rules.columns if _is_channel(column, table))
    flags, found = quality.inspect(t, checked, rules.rate, rules.gap, rules.leap)
    if table.cut_end:
        flags[-1] |= np.uint16(Flag.SUSPECT)
        text = "the file ends within its last row or part: the last number may be cut"
        found.append(Found("note", "cut-end", text, "", 1, len(t) - 1, float(t[-1])))
    found += [Found("doubt", "contradiction", text) for text in table.doubts]
    if table.left_out:
        text = f"columns that the map does not name are not taken: {', '.join(table.left_out)[:400]}"
        found.append(Found("note", "left-out", text))
    values = {channel.rule.role: channel.si for channel in checked}
    follower = FOLLOWS[rules.kind]
    if follower in values and rules.trials.by != "gap":
        doubt = quality.against_sign(flags, values, follower)
        found += [doubt] if doubt else []
    declared = rules.column("pressure")
    if rules.kind == "recorded-step" and declared is not None and (late := pressure_late(t, values, flags)):
        found.append(replace(late, level="note") if any(declared.late_by) else late)
    muscle = _muscle(rules, named.point)
    flags, more, questions = plausible.judge(t, checked, flags, muscle, rules.confirmed)
    found += more
    phase = rules.column("phase")
    if phase is not None and phase.column in table.columns:
        values["phase"] = table.columns[phase.column]
    parts = segments(t, values, flags, rules, named.point)
    if not parts:
        found.append(Found("fault", "no-trial", f"no trial was found: no {rules.trials.by} of the size in the map"))
    told = tuple(_placed(each, t) for each in found)
    return _Prepared(
        table, named, t, checked, flags, told, tuple(parts), _notes(path, rules.notes), muscle.held, tuple(questions)
    )


def _muscle(rules: ImportMap, point: Mapping[str, float]) -> Muscle:
    """What map and name tell of the muscle in a file."""
    size = {key: rules.specimen.get(key) for key in ("inner_diameter", "nominal_length")}
    diameter, length = (float(value) if value is not None else None for value in size.values())
    return Muscle(diameter, length, point.get("contraction"), held=rules.kind == "isometric")


def _placed(found: Found, t: Array) -> Found:
    """What is about the whole file begins with its first row."""
    return found if found.index is not None else replace(found, index=0, t=float(t[0]), count=len(t))


def _is_channel(column: ColumnRule, table: Table) -> bool:
    return column.role not in {"time", "phase"} and column.column in table.columns


def _checked(table: Table, rule: ColumnRule) -> Checked:
    raw = (
        (table.columns[rule.column] - rule.back[1]) / rule.back[0]
        if rule.back != (1.0, 0.0)
        else table.columns[rule.column]
    )
    if rule.whole and bool(np.all(quality.whole_counts(raw))) and float(np.abs(raw).max()) < 2**31 - 1:
        raw = np.round(raw)
    with np.errstate(over="ignore", invalid="ignore"):
        return Checked(rule, raw, raw * rule.slope + rule.offset)


def _named(path: Path, rules: ImportMap, started: datetime | None) -> _Named:
    """`started`: what the file says itself; the map and names come before it."""
    point, test = dict(rules.point), 0
    started = started.replace(tzinfo=UTC) if started is not None else None
    if rules.recorded:
        started = datetime.fromisoformat(rules.recorded).replace(tzinfo=UTC)
    rule = rules.name_rule
    if rule is None:
        return _Named(point, test, started)
    name = path.resolve().parent.name if rule.of == "folder" else path.stem
    match = next((m for form in rule.forms if (m := form.fullmatch(name[:255])) is not None), None)
    if match is None:
        raise invalid(path, f'the name of its {rule.of}, "{name[:80]}", fits none of the forms in the map')
    told = {key: text for key, text in match.groupdict().items() if text is not None}
    point |= rule.otherwise
    point |= _numbers_told(told, rule)
    if "date" in told:
        try:
            started = datetime.strptime(told["date"] + told.get("clock", "000000"), "%Y-%m-%d%H%M%S").replace(
                tzinfo=UTC
            )
        except ValueError as error:
            raise invalid(path, f'the name of its {rule.of} tells no date: "{told["date"]}"') from error
    return _Named(point, int(told.get("test", "0")), started)


def _numbers_told(told: Mapping[str, str], rule: NameRule) -> dict[str, float]:
    return {key: float(text.replace(",", ".")) * rule.factors[key] for key, text in told.items() if key in rule.factors}


def _notes(path: Path, pattern: str | None) -> tuple[str, bytes] | None:
    if pattern is None:
        return None
    found = sorted(p for p in path.resolve().parent.iterdir() if fnmatchcase(p.name, pattern) and p.is_file())
    if len(found) > 1:
        raise invalid(path, f'more than one file of notes fits "{pattern}": {found[0].name}, {found[1].name}')
    if not found:
        return None
    if found[0].stat().st_size > NOTES_BYTES:
        raise invalid(found[0], f"is larger than {NOTES_BYTES} bytes: no notes")
    return found[0].name, found[0].read_bytes()


def _summary(prepared: _Prepared) -> Summary:
    """Peaks of the samples that are neither dropouts nor out of range."""
    good = (prepared.flags & np.uint16(Flag.DROPOUT | Flag.OVERRANGE | Flag.TIME_JUMP)) == 0
    peaks: dict[str, float] = {}
    numbers: dict[str, float] = {}
    for channel in prepared.checked:
        if good.any():
            peaks[channel.rule.role] = float(channel.si[good].max())
            numbers[channel.rule.role] = float(prepared.table.columns[channel.rule.column][good].max())
    point = tuple(sorted((name, round(value, 9)) for name, value in prepared.named.point.items()))
    trusted = not any(found.level == "fault" for found in prepared.findings)
    return Summary(point, peaks, numbers, trusted, _slope(prepared) if prepared.held else None)


def _slope(prepared: _Prepared) -> float | None:
    """Slope of force over pressure where there is force [N/Pa]."""
    values = {channel.rule.role: channel.si for channel in prepared.checked}
    if not {"pressure", "force"} <= set(values):
        return None
    good = (prepared.flags & np.uint16(UNUSABLE)) == 0
    return slope_of(values["pressure"][good], values["force"][good]) if good.any() else None


def _write(prepared: _Prepared, rules: ImportMap, apart: Sequence[Found], out: Path) -> ImportedRun:
    """One run from one prepared file; removes what it began where it fails."""
    flags = prepared.flags
    if any(found.level == "fault" and not found.withholds for found in apart):
        flags = flags | np.uint16(Flag.SUSPECT)
    findings = (*prepared.findings, *(_placed(found, prepared.t) for found in apart))
    counts = {str(flag.name).lower(): int(np.count_nonzero(flags & np.uint16(flag))) for flag in Flag if flag}
    flagged = {name: count for name, count in counts.items() if count}
    started = prepared.named.started or datetime.now(UTC)
    name = run_name(started, f"{rules.specimen['type']}-{rules.specimen['serial']}", rules.kind, simulated=False)
    manifest = _manifest(prepared, rules, findings, flagged, started)
    writer = RunWriter.create(out, name, manifest, _snapshots(prepared, rules))
    writer.waits = True
    try:
        columns = [channel.rule.record(_is_int(channel)) for channel in prepared.checked]
        period = float(np.median(np.abs(np.diff(prepared.t)))) if len(prepared.t) > 1 else 0.0
        writer.open_stream("file", columns, 1.0 / period if period > 0 else 0.0)
        time_ns = np.round(prepared.t * 1e9).astype(np.int64)
        raw = {c.rule.role: c.raw.astype(np.int32) if _is_int(c) else c.raw for c in prepared.checked}
        writer.append("file", time_ns, raw, flags)
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
        kind=rules.kind,
        rows=len(prepared.t),
        trials=len(prepared.parts),
        findings=findings,
        flagged=flagged,
    )


def _is_int(channel: Checked) -> bool:
    """Stored as int32: whole counts throughout."""
    raw = channel.raw
    return channel.rule.whole and bool(np.array_equal(raw, np.round(raw))) and float(np.abs(raw).max()) < 2**31 - 1


def _events(writer: RunWriter, prepared: _Prepared) -> None:
    for index, part in enumerate(prepared.parts):
        told = {"point": dict(part.point), "repeat": prepared.named.test, "reference": False}
        writer.event("trial-begin", part.begin, trial=index, **told)
        lines = [(command["t"], "command", {k: v for k, v in command.items() if k != "t"}) for command in part.commands]
        lines += [(at, "phase", {"name": name}) for at, name in part.phases]
        for at, kind, data in sorted(lines, key=lambda line: line[0]):
            writer.event(kind, at, trial=index, **data)
        writer.event("trial-end", part.end, trial=index, status="finished")


def _snapshots(prepared: _Prepared, rules: ImportMap) -> dict[str, bytes]:
    """The source as it is, its notes, and the map with all that it includes."""
    kept = {f"source/{_legal(prepared.table.path.name)}": prepared.table.content}
    if prepared.notes is not None:
        kept[f"source/notes-{_legal(prepared.notes[0])}"] = prepared.notes[1]
    for number, (path, text) in enumerate(rules.texts.items()):
        kept["map.yaml" if path == rules.path else f"map-included-{number}.yaml"] = text.encode()
    return kept


def _legal(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]", "-", name)[-100:].lstrip("._-") or "file"


def _manifest(
    prepared: _Prepared, rules: ImportMap, findings: Sequence[Found], flagged: Mapping[str, int], started: datetime
) -> dict[str, Any]:
    table = prepared.table
    notes = prepared.notes[1].decode("utf-8", "replace") if prepared.notes is not None else ""
    told = [plain(found) for found in findings]
    for found in told:
        found["line"] = None if found["index"] is None else int(table.lines[found["index"]])
    return {
        "kind": rules.kind,
        "protocol": rules.name,
        "source": rules.source,
        "simulated": False,
        "started_utc": started.isoformat(timespec="milliseconds"),
        "operator": "",
        "bench": rules.bench,
        "specimen": dict(rules.specimen),
        "trials_planned": len(prepared.parts),
        "imported": {
            "file": table.path.name,
            "folder": table.path.resolve().parent.name,
            "sha256": table.sha256,
            "bytes": len(table.content),
            "rows": len(prepared.t),
            "started_known": prepared.named.started is not None,
            "map": Path(rules.path).name,
            "map_sha256": hashlib.sha256("".join(rules.texts.values()).encode()).hexdigest(),
            "notes": notes,
            "findings": told,
            "unresolved": [dict(question) for question in prepared.questions],
            "flagged": dict(flagged),
            "late_by": {c.rule.role: list(c.rule.late_by) for c in prepared.checked if any(c.rule.late_by)},
            "analysis": rules.analysis.model_dump(mode="json"),
        },
    }
