"""Reads, scales and checks one foreign file, and cuts it into trials; writes nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, time
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path

import numpy as np

from pmabench.base.errors import InvalidFile, Problem, invalid
from pmabench.base.kind import Imported
from pmabench.base.quantities import show
from pmabench.store.importers import long, plausible, quality
from pmabench.store.importers.found import Checked, Found, Summary
from pmabench.store.importers.long import Seen
from pmabench.store.importers.magnitude import Muscle, slope_of_held
from pmabench.store.importers.map_file import Question, made, spelled
from pmabench.store.importers.map_rules import ColumnRule, ImportMap, number_in
from pmabench.store.importers.plausible import pressure_late
from pmabench.store.importers.segments import Segment, segments
from pmabench.store.importers.table import Table, read_table, with_made
from pmabench.store.records import Array, Flag, Flags

NOTES_BYTES = 100_000
SAME = 0.5
"""Largest share of rows with the time stamp of the row before; above it the time is too coarse."""


@dataclass(frozen=True)
class Named:
    """Data from the name of a file and from the map."""

    point: Mapping[str, float]
    test: int
    started: datetime | None


@dataclass(frozen=True)
class Prepared:
    """One test of one file, read and checked."""

    table: Table
    named: Named
    t: Array
    """Time stamps [s]; for a long file only of the rows for cutting into trials."""
    checked: tuple[Checked, ...]
    """Channels of the same rows as `t`."""
    flags: Flags
    """Flags of all rows."""
    findings: tuple[Found, ...]
    parts: tuple[Segment, ...]
    notes: tuple[str, bytes] | None
    rules: ImportMap
    """The map of this test."""
    name: str
    """Name of this test in the file; empty if it is the only one."""
    whole: frozenset[str]
    """Roles of channels with whole counts throughout, which are stored as int32."""
    period: float
    """Median sampling period [s]."""
    summary: Summary
    questions: tuple[Question, ...]
    """Open questions of the map, and those that the numbers cannot decide."""
    simulated: bool

    def blocks(self) -> Iterator[tuple[Array, tuple[Checked, ...]]]:
        """Time stamps [s] and channels of all rows in order, in blocks that fit into memory."""
        if len(self.t) == len(self.table):
            yield self.t, self.checked
            return
        for begin, end in long.parts(len(self.table)):
            part = self.table.part(begin, end)
            yield times(part, self.rules), channels_of(part, self.rules)


def prepare(path: Path, rules: ImportMap) -> Prepared:
    """Read, scale and check the first test of a file."""
    return prepare_all(path, rules)[0]


def prepare_all(path: Path, rules: ImportMap) -> list[Prepared]:
    """Read, scale and check every test of one file."""
    found = [(each, table) for each in rules.each_test() for table in _read(path, each).tests()]
    if rules.tests and len(found) != len(rules.tests):
        raise invalid(path, f"holds {len(found)} tests, the map gives the points of {len(rules.tests)}")
    prepared = []
    for number, (each, table) in enumerate(found):
        name = "" if len(found) == 1 else list(rules.tests)[number] if rules.tests else str(number + 1)
        prepared.append(_prepared(path, rules.of_test(number, each), table, name, number))
    return prepared


def _read(path: Path, rules: ImportMap) -> Table:
    wanted = [column.column for column in rules.columns if not column.optional and not made(column.column)]
    optional = [column.column for column in rules.columns if column.optional]
    return read_table(path, rules.file.file, wanted, optional, rules.ignored, rules.stamps)


def _prepared(path: Path, rules: ImportMap, table: Table, name: str, number: int) -> Prepared:
    _units_agree(path, rules.columns, table.units)
    named = _named(path, rules, table.started)
    if name:
        named = replace(named, test=named.test or number + 1)
    table, constant = _with_constants(path, rules, table, named.point)
    looked = long.inspected(table, rules, lambda part: _inspected(path, rules, part), _summed)
    seen, found = looked.seen, looked.seen.found + constant
    specimen = rules.file.specimen
    muscle = Muscle(
        specimen.inner_diameter, specimen.nominal_length, named.point.get("contraction"), _held(rules),
        _moves(rules.test), rules.test.follows == "force",
    )  # fmt: skip
    said = rules.column("point of contraction")
    values = seen.values.get(said.role) if said is not None else None
    lengths = Checked(said, values, values) if said is not None and values is not None else None
    more, questions = plausible.judge(seen.t, seen.checked, seen.flags, muscle, rules.file.confirmed, lengths)
    found += looked.placed(more)
    parts, doubts = segments(seen.t, seen.values, seen.flags, rules, named.point)
    found += [Found("doubt", "trial", text) for text in doubts]
    if not parts:
        found.append(Found("fault", "no-trial", f"no trial was found: no {rules.trials.by} of the size in the map"))
    known = tuple(placed(each, seen.t, len(table)) for each in found)
    return Prepared(
        table=table,
        named=named,
        t=seen.t,
        checked=seen.checked,
        flags=looked.flags,
        findings=known,
        parts=tuple(parts),
        notes=_notes(path, rules.file.notes),
        rules=rules,
        name=name,
        whole=looked.whole,
        period=looked.period,
        summary=Summary(
            tuple(sorted((key, round(value, 9)) for key, value in named.point.items())),
            looked.peaks,
            not any(each.level == "fault" for each in known),
            slope_of_held(seen.values, seen.flags) if muscle.held else None,
            tuple((name, part.point[name]) for part in parts for name in part.measured),
        ),
        questions=(*rules.unresolved, *questions),
        simulated=rules.file.simulated or bool(np.any(seen.values.get("simulated", 0.0))),
    )


def _units_agree(path: Path, columns: Sequence[ColumnRule], units: Mapping[str, str]) -> None:
    """Raise InvalidFile where file and map give different units for a column."""
    problems = []
    for column in columns:
        said, mapped = spelled(units.get(column.column, "")), spelled(column.raw_unit)
        if said and mapped and said != mapped and column.back == (1.0, 0.0):
            way = f'"written: index" with "period: 1 {mapped}"'
            if column.is_channel:
                way = f'"unit: {said}" with "line: {{slope: 1 {mapped}/{said}, offset: 0 {mapped}}}"'
            text = f'says that the unit of "{column.column}" is {said}, the map says {mapped}; where its label is '
            problems.append(Problem(str(path), 0, 0, f"{text}wrong write {way}"))
    if problems:
        raise InvalidFile(problems)


def _with_constants(
    path: Path, rules: ImportMap, table: Table, point: Mapping[str, float]
) -> tuple[Table, list[Found]]:
    """The table with added constant columns, each a coordinate of the operating point, and findings about them."""
    found = []
    for rule in rules.columns:
        if not (coordinate := made(rule.column)):
            continue
        if coordinate not in point:
            text = f'"{rule.column}" is the {coordinate} of the whole file, and neither its name nor the map gives one'
            where = f'trials: {{point: {{{coordinate}: ...}}}}, or {{{coordinate}}} in "name_tells"'
            raise invalid(path, f"{text}: say {where}")
        value = np.float64((point[coordinate] - rule.offset) / rule.slope)
        table = with_made(table, rule.column, partial(np.full_like, fill_value=value, dtype=np.float64))
        text = f"{rule.role} was not recorded: {show(point[coordinate], rule.quantity)} throughout, as map or name says"
        known = bool(rule.calibration["offset_uncertainty"] or rule.calibration["gain_uncertainty"])
        more = "" if known else "; how far it was from that no result includes: say expanded_uncertainty"
        found.append(Found("note" if known else "doubt", "constant", text + more, rule.role))
    return table, found


def _held(rules: ImportMap) -> bool:
    """Whether the muscle is held at one length throughout a file, so that its force follows pressure."""
    return rules.test.held and rules.trials.by in ("file", "ramp")


def _moves(test: Imported) -> bool:
    """Whether the length changes in every test of a kind: it follows the pressure, is driven, or pulled."""
    driven = test.commanded is not None and test.commanded.output == "displacement"
    return driven or test.follows == "displacement" or (test.recording and not test.held)


def _own_flags(path: Path, values: Array) -> Flags:
    """Flags from a column of the file, as written by `pmabench export`."""
    most = sum(Flag)
    if not np.all((values >= 0) & (values <= most) & (values == np.round(values))):
        raise invalid(path, f"a value of its flags is no whole number from 0 to {most}")
    return np.asarray(values.astype(np.uint16))


def _gaps_within(t: Array, flags: Flags, trial: Array, gap: float) -> None:
    """Flag gaps within trials, but not pauses between trials."""
    late = np.concatenate([[False], (np.diff(t) > gap) & (np.diff(trial) == 0) & (trial[1:] != 0)])
    flags[late] |= np.uint16(Flag.GAP)


def times(table: Table, rules: ImportMap) -> Array:
    """Time stamps [s] of a table in memory; raises InvalidFile where a row has none."""
    time = next(column for column in rules.columns if column.role == "time")
    t = table.columns[time.column] * time.slope
    if np.isnan(t).any() or np.abs(t).max() > 9e9:
        row = int(np.argmax(~(np.abs(t) <= 9e9)))
        raise invalid(table.path, "a row has no time, or one out of all range", table.line(row), 1)
    return t


def _coarse(table: Table, t: Array) -> None:
    """Raise InvalidFile where most rows have the time of the row before, so that their times are unknown."""
    steps = np.diff(t)
    same, forward = int(np.count_nonzero(steps == 0)), steps[steps > 0]
    if same <= SAME * len(t) or not len(forward):
        return
    text = f"{same} of {len(t)} time stamps equal the one before, for they are written in steps of "
    text += f"{np.median(forward):.3g} s: when each row was taken is not known. Export the time with its fraction, "
    text += 'or "ignore" it and say "period"'
    raise invalid(table.path, text, table.line(int(np.argmax(steps == 0)) + 1), 1)


def channels_of(table: Table, rules: ImportMap) -> tuple[Checked, ...]:
    """The channels of a table in memory, raw and in SI units."""
    there = (rule for rule in rules.columns if rule.is_channel and rule.column in table.columns)
    return tuple(_checked(table, rule) for rule in there)


def _inspected(path: Path, rules: ImportMap, table: Table) -> Seen:
    """Scale and check the rows of a table in memory."""
    t, checked = times(table, rules), channels_of(table, rules)
    _coarse(table, t)
    others = {
        c.role: c.slope * table.columns[c.column]
        for c in rules.columns
        if not c.is_channel and c.role not in ("time", "date") and c.column in table.columns
    }
    paused = rules.trials.by == "column"
    sampling = rules.file.sampling
    gap, leap = (np.inf, np.inf) if paused else (sampling.gap, sampling.leap)
    flags, found = quality.inspect(t, checked, sampling.rate, gap, leap)
    if paused:
        _gaps_within(t, flags, others["trial"], sampling.gap)
    if "flags" in others:
        flags |= _own_flags(path, others["flags"])
    if not paused:
        flags, more = plausible.stopped(t, checked, flags, held=_held(rules))
        found += more
    last = "", 1, len(t) - 1, float(t[-1])
    if table.cut_end:
        flags[-1] |= np.uint16(Flag.SUSPECT)
        text = "the file ends within its last row or part: the last number may be cut"
        found.append(Found("note", "cut-end", text, *last))
    if table.cut_row:
        found.append(Found("doubt", "cut-row", table.cut_row, *last))
    found += [Found("doubt", "contradiction", text) for text in table.doubts]
    if table.left_out:
        text = f"columns that the map does not name are not taken: {', '.join(table.left_out)[:400]}"
        found.append(Found("note", "left-out", text))
    values = {**others, **{channel.rule.role: channel.si for channel in checked}}
    follows = rules.test.follows
    if follows in values and rules.trials.by != "gap" and (doubt := quality.against_sign(flags, values, follows)):
        found.append(doubt)
    declared = rules.column("pressure")
    if rules.test.timed and declared is not None and (late := pressure_late(t, values, flags)):
        found.append(replace(late, level="note") if any(declared.late_by) else late)
    return Seen(t, checked, values, flags, found)


def _summed(seen: Seen) -> tuple[frozenset[str], Mapping[str, float]]:
    """Roles with whole counts, and peaks [SI] without dropouts, overrange and time jumps."""
    good = (seen.flags & np.uint16(Flag.DROPOUT | Flag.OVERRANGE | Flag.TIME_JUMP)) == 0
    peaks = {channel.rule.role: float(channel.si[good].max()) for channel in seen.checked if good.any()}
    return frozenset(channel.rule.role for channel in seen.checked if _is_int(channel)), peaks


def placed(found: Found, t: Array, rows: int) -> Found:
    """The finding with a row: one about the whole file gets the first."""
    return found if found.index is not None else replace(found, index=0, t=float(t[0]), count=rows)


def _checked(table: Table, rule: ColumnRule) -> Checked:
    raw = table.columns[rule.column]
    if rule.back != (1.0, 0.0):
        raw = (raw - rule.back[1]) / rule.back[0]
    if rule.whole and np.all(quality.whole_counts(raw)) and np.abs(raw).max() < 2**31 - 1:
        raw = np.round(raw)
    with np.errstate(over="ignore", invalid="ignore"):
        return Checked(rule, raw, raw * rule.slope + rule.offset)


def _named(path: Path, rules: ImportMap, started: datetime | None) -> Named:
    """Operating point, test number and start of a file; map and name take precedence over `started` of the file."""
    point, test = dict(rules.point), 0
    started = started.replace(tzinfo=UTC) if started is not None else None
    if rules.file.recorded is not None:
        started = datetime.combine(rules.file.recorded, time(), UTC)
    rule = rules.name_rule
    if rule is None:
        return Named(point, test, started)
    name = path.resolve().parent.name if rule.of == "folder" else path.stem
    match = next((m for form in rule.forms if (m := form.fullmatch(name[:255])) is not None), None)
    if match is None:
        raise invalid(path, f'the name of its {rule.of}, "{name[:80]}", fits none of the forms in the map')
    data = {key: text for key, text in match.groupdict().items() if text is not None}
    point |= rule.otherwise
    point |= {key: number_in(data[key]) * factor for key, factor in rule.factors.items() if key in data}
    if "date" in data:
        try:
            stamp = f"{data['date']}{data.get('clock', '000000')}+0000"
            started = datetime.strptime(stamp, "%Y-%m-%d%H%M%S%z")
        except ValueError as error:
            raise invalid(path, f'the name of its {rule.of} is no date: "{data["date"]}"') from error
    return Named(point, int(data.get("test", "0")), started)


def _notes(path: Path, pattern: str | None) -> tuple[str, bytes] | None:
    if pattern is None:
        return None
    found = sorted(p for p in path.resolve().parent.iterdir() if fnmatchcase(p.name, pattern) and p.is_file())
    if len(found) > 1:
        raise invalid(path, f'more than one file of notes fits "{pattern}": {found[0].name}, {found[1].name}')
    if found and found[0].stat().st_size > NOTES_BYTES:
        raise invalid(found[0], f"is larger than {NOTES_BYTES} bytes: no notes")
    return (found[0].name, found[0].read_bytes()) if found else None


def _is_int(channel: Checked) -> bool:
    """Whether a channel has whole counts throughout, and can be stored as int32."""
    raw = channel.raw
    return channel.rule.whole and bool(np.array_equal(raw, np.round(raw))) and float(np.abs(raw).max()) < 2**31 - 1
