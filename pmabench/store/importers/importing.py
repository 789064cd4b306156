"""Old files to runs: one run per file, the file itself kept inside it, what is wrong told and flagged.

All files are read and checked before anything is written; what is written before a failure is taken away again.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from pmabench.base.errors import InvalidFile, Problem, invalid
from pmabench.store.exported import NAME as RECORD
from pmabench.store.exported import Exported, read_record
from pmabench.store.folder import PLAN, Copy
from pmabench.store.importers import long, plausible, quality, siblings, units
from pmabench.store.importers.found import Checked, Found, plain
from pmabench.store.importers.long import Seen
from pmabench.store.importers.magnitude import muscle_of, slope_of_held
from pmabench.store.importers.map_rules import ColumnRule, ImportMap, NameRule, read_map
from pmabench.store.importers.order import pressure_late
from pmabench.store.importers.questions import Question
from pmabench.store.importers.segments import Segment, segments
from pmabench.store.importers.siblings import Summary
from pmabench.store.importers.table import Table, read_table
from pmabench.store.naming import run_name
from pmabench.store.records import Array, Flag, Flags
from pmabench.store.trials import trial_spans
from pmabench.store.writer import RunWriter

NOTES_BYTES = 100_000
FOLLOWS = {
    "isometric": "force",
    "recorded-pull": "force",
    "isometric-pressurisation": "force",
    "recorded-step": "displacement",
    "recorded-sine": "displacement",
    "contraction-relaxation": "displacement",
    "static-load": "displacement",
    "free-contraction": "displacement",
}
"""Kind of run -> channel that rises with pressure."""
MOST_FILES = 10_000
PAUSED = ("record", "column")
"""Ways to cut a file whose trials are marked: between them nothing need be recorded."""
UNTOLD = "not told"
"""What a proposed map says of a specimen that no file names."""
SAME = 0.5
"""Share of rows with the time stamp of the row before, above which the time is too coarse for the rows."""


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
    unresolved: tuple[Question, ...] = ()
    """Questions of the map that nobody answered."""


@dataclass(frozen=True)
class _Named:
    """What the name of a file says."""

    point: Mapping[str, float]
    test: int
    started: datetime | None


@dataclass(frozen=True)
class _Prepared:
    """One test of one file, read and checked."""

    table: Table
    named: _Named
    t: Array
    """Time stamps [s]; of a long file those of the rows on which trials were cut."""
    checked: tuple[Checked, ...]
    """Channels of the same rows as `t`."""
    flags: Flags
    """Of all rows."""
    findings: tuple[Found, ...]
    parts: tuple[Segment, ...]
    notes: tuple[str, bytes] | None
    rules: ImportMap
    """Of this test."""
    name: str
    """Of this test among those of the file; empty where it is the only one."""
    whole: frozenset[str]
    """Roles of channels that are stored as int32: whole counts throughout."""
    period: float
    """Median distance of the samples [s]."""
    summary: Summary
    questions: tuple[Question, ...]
    """Of the map, and what its numbers cannot decide."""
    record: Exported | None
    """What the run that the file was exported from said beyond its columns."""
    simulated: bool

    def blocks(self) -> Iterator[tuple[Array, tuple[Checked, ...]]]:
        """Time stamps [s] and channels of all rows in order, so many at a time as fit into memory."""
        if len(self.t) == len(self.table):
            yield self.t, self.checked
            return
        for begin, end in long.parts(len(self.table)):
            part = self.table.part(begin, end)
            yield _times(part, self.rules), _channels(part, self.rules)


def import_files(
    files: Sequence[Path],
    map_path: Path,
    out: Path,
    answers: Sequence[tuple[str, str]] = (),
    *,
    unresolved: bool = False,
) -> list[ImportedRun]:
    """Make one run below `out` of each test in the files, as the map at `map_path` says; files are never touched.

    `answers` and `unresolved`: to the questions of the map, as for `read_map`.

    Raises InvalidFile with the problems of the map, or else of all files, and leaves nothing behind then. Files of one
    call are compared with each other where the map names `siblings`.
    """
    rules = read_map(map_path, answers, unresolved=unresolved)
    if not files or len(files) > MOST_FILES:
        raise invalid(map_path, f"is for 1 to {MOST_FILES} files at a time, {len(files)} were given")
    problems: list[Problem] = []
    summaries: list[Summary] = []
    hashes: list[str] = []
    prepared: list[_Prepared] = []
    for path in files:
        try:
            prepared = prepare_all(path, rules)
        except InvalidFile as error:
            problems.extend(error.problems)
            continue
        summaries += [each.summary for each in prepared]
        hashes.append(prepared[0].table.sha256)
    if not problems:
        problems = [
            Problem(str(path), 0, 0, f"holds the same bytes as {files[hashes.index(digest)]}")
            for number, (path, digest) in enumerate(zip(files, hashes, strict=True))
            if hashes.index(digest) != number
        ]
    if problems:
        raise InvalidFile(problems)
    found = siblings.compare(summaries, rules.siblings)
    among = iter([plausible.answered(each, rules.confirmed) for each in found])
    made: list[ImportedRun] = []
    existed = out.exists()
    try:
        for path, digest in zip(files, hashes, strict=True):
            if len(files) > 1:
                prepared = prepare_all(path, rules)
            for each in prepared:
                if each.table.sha256 != digest:
                    raise invalid(path, "was changed while it was read")
                made.append(_write(each, rules, next(among), out))
    except BaseException:
        for run in made:
            shutil.rmtree(run.path, ignore_errors=True)
        if not existed:
            with suppress(OSError):
                out.rmdir()
        raise
    return made


def prepare(path: Path, rules: ImportMap) -> _Prepared:
    """Read, scale and check one file, of several tests in it the first."""
    return prepare_all(path, rules)[0]


def prepare_all(path: Path, rules: ImportMap) -> list[_Prepared]:
    """Read, scale and check every test of one file."""
    found = [(each, table) for each in rules.each_test() for table in _read(path, each).tests()]
    if rules.tests and len(found) != len(rules.tests):
        told = f"holds {len(found)} tests, the map gives the points of {len(rules.tests)}"
        raise invalid(path, told)
    prepared = []
    for number, (each, table) in enumerate(found):
        name = "" if len(found) == 1 else rules.tests[number].name if rules.tests else str(number + 1)
        prepared.append(_prepared(path, rules.of_test(number, each), table, name, number))
    return prepared


def _read(path: Path, rules: ImportMap) -> Table:
    wanted = [column.column for column in rules.columns if not column.optional]
    optional = [column.column for column in rules.columns if column.optional]
    return read_table(path, rules.layout, wanted, optional, rules.ignored, rules.stamps)


def _prepared(path: Path, rules: ImportMap, table: Table, name: str, number: int) -> _Prepared:
    units.agree(path, rules.columns, table.units)
    named = _named(path, rules, table.started)
    if name:
        named = replace(named, test=named.test or number + 1)
    record = _record_of(path, rules)
    looked = long.inspected(table, rules, lambda part: _inspected(path, rules, part, record), _summed)
    seen, found = looked.seen, looked.seen.found
    muscle = muscle_of(rules.specimen, named.point, held=_held(rules))
    questions: list[Question] = []
    if record is None:
        more, questions = plausible.judge(seen.t, seen.checked, seen.flags, muscle, rules.confirmed)
        found += looked.placed(more)
        parts, doubts = segments(seen.t, seen.values, seen.flags, rules, named.point)
        found += [Found("doubt", "trial", text) for text in doubts]
    else:
        parts = [Segment(begin, end, {}) for begin, end in trial_spans(record.events)]
        if named.started is None and record.started:
            named = replace(named, started=datetime.fromisoformat(record.started))
    if not parts:
        found.append(Found("fault", "no-trial", f"no trial was found: no {rules.trials.by} of the size in the map"))
    told = tuple(_placed(each, seen.t, len(table)) for each in found)
    return _Prepared(
        table=table,
        named=named,
        t=seen.t,
        checked=seen.checked,
        flags=looked.flags,
        findings=told,
        parts=tuple(parts),
        notes=_notes(path, rules.notes),
        rules=rules,
        name=name,
        whole=looked.whole,
        period=looked.period,
        summary=Summary(
            tuple(sorted((key, round(value, 9)) for key, value in named.point.items())),
            {role: pair[0] for role, pair in looked.peaks.items()},
            {role: pair[1] for role, pair in looked.peaks.items()},
            not any(each.level == "fault" for each in told),
            slope_of_held(seen.values, seen.flags) if muscle.held else None,
        ),
        questions=(*rules.unresolved, *questions),
        record=record,
        simulated=rules.simulated
        or (record is not None and record.simulated)
        or bool(np.any(seen.values.get("simulated", 0.0))),
    )


def _held(rules: ImportMap) -> bool:
    """Whether the muscle is held at one length throughout a file, so that its force follows pressure."""
    return rules.kind == "isometric" and rules.trials.by in ("file", "ramp")


def _record_of(path: Path, rules: ImportMap) -> Exported | None:
    """The record next to an exported file, where the map asks for it."""
    if rules.trials.by != "record":
        return None
    place = path.resolve().parent / RECORD
    record = read_record(place)
    if record.file != path.name:
        raise invalid(place, f"is the record of {record.file}, not of {path.name}")
    if record.kind != rules.kind:
        raise invalid(place, f'is of a run of kind "{record.kind}", the map says "{rules.kind}"')
    return record


def _flags_told(path: Path, values: Array) -> Flags:
    """Flags that the file itself gives its samples, as `pmabench export` writes them."""
    most = sum(Flag)
    if not np.all((values >= 0) & (values <= most) & (values == np.round(values))):
        raise invalid(path, f"a value of its flags is no whole number from 0 to {most}")
    return np.asarray(values.astype(np.uint16))


def _gaps_within(t: Array, flags: Flags, values: Mapping[str, Array], record: Exported | None, gap: float) -> None:
    """Flag gaps within trials; between them nothing was recorded, and that is none."""
    if record is not None:
        begins = np.array(sorted(begin for begin, _ in trial_spans(record.events)))
        trial = np.searchsorted(begins, t - 1e-6).astype(np.float64)
    else:
        trial = values["trial"]
    late = np.concatenate([[False], (np.diff(t) > gap) & (np.diff(trial) == 0) & (trial[1:] != 0)])
    flags[late] |= np.uint16(Flag.GAP)


def _times(table: Table, rules: ImportMap) -> Array:
    """Time stamps [s] of a table in memory; raises InvalidFile where a row has none."""
    time = next(column for column in rules.columns if column.role == "time")
    t = table.columns[time.column] * time.slope
    if np.isnan(t).any() or np.abs(t).max() > 9e9:
        row = int(np.argmax(~(np.abs(t) <= 9e9)))
        raise invalid(table.path, "a row has no time, or one out of all range", table.line(row), 1)
    return t


def _coarse(table: Table, t: Array) -> None:
    """Raises InvalidFile where most rows have the time of the row before: when they were taken nobody knows."""
    steps = np.diff(t)
    same, forward = int(np.count_nonzero(steps == 0)), steps[steps > 0]
    if same <= SAME * len(t) or not len(forward):
        return
    told = (
        f"{same} of {len(t)} time stamps equal the one before, for they are written in steps of "
        f"{np.median(forward):.3g} s: when each row was taken is not known. "
        'Export the time with its fraction, or "ignore" it and say "period"'
    )
    raise invalid(table.path, told, table.line(int(np.argmax(steps == 0)) + 1), 1)


def _channels(table: Table, rules: ImportMap) -> tuple[Checked, ...]:
    return tuple(_checked(table, column) for column in rules.columns if _is_channel(column, table))


def _inspected(path: Path, rules: ImportMap, table: Table, record: Exported | None) -> Seen:
    """Scale and check the rows of a table in memory."""
    t, checked = _times(table, rules), _channels(table, rules)
    _coarse(table, t)
    others = {
        c.role: c.slope * table.columns[c.column]
        for c in rules.columns
        if not c.is_channel and c.role not in ("time", "date") and c.column in table.columns
    }
    paused = rules.trials.by in PAUSED
    flags, found = quality.inspect(t, checked, rules.rate, *((np.inf, np.inf) if paused else (rules.gap, rules.leap)))
    if paused:
        _gaps_within(t, flags, others, record, rules.gap)
    if "flags" in others:
        flags |= _flags_told(path, others["flags"])
    if not paused:
        flags, more = plausible.stopped(t, checked, flags, held=_held(rules))
        found += more
    if table.cut_end:
        flags[-1] |= np.uint16(Flag.SUSPECT)
        text = "the file ends within its last row or part: the last number may be cut"
        found.append(Found("note", "cut-end", text, "", 1, len(t) - 1, float(t[-1])))
    if table.cut_row:
        found.append(Found("doubt", "cut-row", table.cut_row, "", 1, len(t) - 1, float(t[-1])))
    found += [Found("doubt", "contradiction", text) for text in table.doubts]
    if table.left_out:
        text = f"columns that the map does not name are not taken: {', '.join(table.left_out)[:400]}"
        found.append(Found("note", "left-out", text))
    values = {**others, **{channel.rule.role: channel.si for channel in checked}}
    follower = FOLLOWS.get(rules.kind, "")
    if follower in values and rules.trials.by != "gap":
        doubt = quality.against_sign(flags, values, follower)
        found += [doubt] if doubt else []
    declared = rules.column("pressure")
    if rules.kind == "recorded-step" and declared is not None and (late := pressure_late(t, values, flags)):
        found.append(replace(late, level="note") if any(declared.late_by) else late)
    return Seen(t, checked, values, flags, found)


def _summed(seen: Seen, table: Table) -> tuple[frozenset[str], Mapping[str, tuple[float, float]]]:
    """Channels of whole counts, and peaks of the samples that are neither dropouts nor out of range."""
    good = (seen.flags & np.uint16(Flag.DROPOUT | Flag.OVERRANGE | Flag.TIME_JUMP)) == 0
    peaks = {
        channel.rule.role: (float(channel.si[good].max()), float(table.columns[channel.rule.column][good].max()))
        for channel in seen.checked
        if good.any()
    }
    return frozenset(channel.rule.role for channel in seen.checked if _is_int(channel)), peaks


def _placed(found: Found, t: Array, rows: int) -> Found:
    """What is about the whole file begins with its first row."""
    return found if found.index is not None else replace(found, index=0, t=float(t[0]), count=rows)


def _is_channel(column: ColumnRule, table: Table) -> bool:
    return column.is_channel and column.column in table.columns


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


def _write(prepared: _Prepared, rules: ImportMap, apart: Sequence[Found], out: Path) -> ImportedRun:
    """One run from one prepared file; removes what it began where it fails."""
    flags = prepared.flags
    if any(found.level == "fault" and not found.withholds for found in apart):
        flags = flags | np.uint16(Flag.SUSPECT)
    findings = (*prepared.findings, *(_placed(found, prepared.t, len(prepared.table)) for found in apart))
    counts = {str(flag.name).lower(): int(np.count_nonzero(flags & np.uint16(flag))) for flag in Flag if flag}
    flagged = {name: count for name, count in counts.items() if count}
    started = prepared.named.started or datetime.now(UTC)
    specimen = _specimen(prepared, rules)
    title = f"{specimen.get('type', '')}-{specimen.get('serial', '')}"
    name = run_name(started, title, rules.kind, simulated=prepared.simulated)
    manifest = _manifest(prepared, rules, findings, flagged, started)
    writer = RunWriter.create(out, name, manifest, _snapshots(prepared, rules))
    writer.waits = True
    try:
        columns = [channel.rule.record(channel.rule.role in prepared.whole) for channel in prepared.checked]
        rate = 1.0 / prepared.period if prepared.period > 0 else 0.0
        writer.open_stream("file", columns, rate if prepared.record is None else prepared.record.rate)
        begin = 0
        for t, checked in prepared.blocks():
            raw = {c.rule.role: c.raw.astype(np.int32) if c.rule.role in prepared.whole else c.raw for c in checked}
            time_ns = np.round(t * 1e9).astype(np.int64)
            writer.append_now("file", time_ns, raw, flags[begin : begin + len(t)])
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
        kind=rules.kind,
        rows=len(prepared.table),
        trials=len(prepared.parts),
        findings=findings,
        flagged=flagged,
        unresolved=prepared.questions,
    )


def _is_int(channel: Checked) -> bool:
    """Stored as int32: whole counts throughout."""
    raw = channel.raw
    return channel.rule.whole and bool(np.array_equal(raw, np.round(raw))) and float(np.abs(raw).max()) < 2**31 - 1


def _specimen(prepared: _Prepared, rules: ImportMap) -> Mapping[str, Any]:
    """As the record of an exported run says, unless the map names another one."""
    told = prepared.record.about.get("specimen") if prepared.record is not None else None
    if not isinstance(told, Mapping):
        return rules.specimen
    same = all(str(told.get(key)) == str(rules.specimen[key]) for key in ("type", "serial"))
    return told if same or rules.specimen["type"] == UNTOLD else rules.specimen


def _events(writer: RunWriter, prepared: _Prepared) -> None:
    if prepared.record is not None:
        for event in prepared.record.events:
            writer.event(event.kind, event.t, **event.data)
        return
    for index, part in enumerate(prepared.parts):
        told = {"point": dict(part.point), "repeat": prepared.named.test, "reference": False}
        writer.event("trial-begin", part.begin, trial=index, **told)
        lines = [(command["t"], "command", {k: v for k, v in command.items() if k != "t"}) for command in part.commands]
        lines += [(at, "phase", {"name": name}) for at, name in part.phases]
        lines += [(found["t"], "found", {k: v for k, v in found.items() if k != "t"}) for found in part.found]
        for at, kind, data in sorted(lines, key=lambda line: line[0]):
            writer.event(kind, at, trial=index, **data)
        writer.event("trial-end", part.end, trial=index, status="finished")


def _snapshots(prepared: _Prepared, rules: ImportMap) -> dict[str, bytes | Copy]:
    """The source as it is, its notes, and the map with all that it includes."""
    table = prepared.table
    kept: dict[str, bytes | Copy] = {f"source/{_legal(table.path.name)}": Copy(table.path, table.sha256)}
    if prepared.notes is not None:
        kept[f"source/notes-{_legal(prepared.notes[0])}"] = prepared.notes[1]
    for number, (path, text) in enumerate(rules.texts.items()):
        kept["map.yaml" if path == rules.path else f"map-included-{number}.yaml"] = text.encode()
    plan = {**(prepared.record.plan if prepared.record is not None else {})}
    if settings := {**(plan.get("settings") or {}), **rules.settings}:
        plan["settings"] = settings
    if plan:
        kept[PLAN] = (json.dumps(plan, indent=1, sort_keys=True) + "\n").encode()
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
        found["line"] = None if found["index"] is None else table.line(found["index"])
    return {
        "kind": rules.kind,
        "protocol": rules.name,
        "source": rules.source,
        "simulated": prepared.simulated,
        "started_utc": started.isoformat(timespec="milliseconds"),
        "operator": "",
        "bench": rules.bench,
        "specimen": dict(_specimen(prepared, rules)),
        "trials_planned": len(prepared.parts),
        "imported": {
            "file": table.path.name,
            "folder": table.path.resolve().parent.name,
            "sha256": table.sha256,
            "bytes": table.size,
            "rows": len(prepared.table),
            **({"test": prepared.name} if prepared.name else {}),
            "started_known": prepared.named.started is not None,
            **({"exported_from": prepared.record.run} if prepared.record is not None else {}),
            "map": Path(rules.path).name,
            "map_sha256": hashlib.sha256("".join(rules.texts.values()).encode()).hexdigest(),
            "notes": notes,
            "findings": told,
            "flagged": dict(flagged),
            "late_by": {c.rule.role: list(c.rule.late_by) for c in prepared.checked if any(c.rule.late_by)},
            "analysis": rules.analysis.model_dump(mode="json"),
            "unresolved": [vars(question) for question in prepared.questions],
        },
    }
