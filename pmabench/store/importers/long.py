"""Files with more rows than fit into memory: inspected in parts, findings merged, and thinned for cutting into trials.

Every part is inspected together with some rows before it, so that faults which begin there are seen; findings in those
rows alone are removed again. Trials are cut on a subset of rows: the lowest and the highest value of each stretch, and
all rows around steps, changes of phase and gaps.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pmabench.store.importers.found import Checked, Found
from pmabench.store.importers.map_rules import ImportMap
from pmabench.store.importers.table import Table
from pmabench.store.records import Array, Flags

PART = 300_000
"""Largest number of rows inspected at once."""
BEFORE = 10_000
"""Number of rows before a part that are inspected with it."""
STRETCHES = 100_000
"""Number of stretches of a long file whose extremes are kept for cutting it into trials."""
OF_WHOLE = frozenset({"left-out", "contradiction", "cut-end", "cut-row"})
"""Kinds of findings about the file as a whole, which are kept only once."""
_ROW = re.compile(r"\b(rows?) (\d+)(?: to (\d+))?")


@dataclass(frozen=True)
class Seen:
    """Result of the inspection of some rows."""

    t: Array
    """Time stamps [s], shape (n,)."""
    checked: tuple[Checked, ...]
    """Channels, shape (n,)."""
    values: Mapping[str, Array]
    """Channels [SI] and other columns by their role, shape (n,)."""
    flags: Flags
    found: list[Found]


@dataclass(frozen=True)
class Inspected:
    """Result of the inspection of a whole file."""

    seen: Seen
    """The rows for cutting into trials, with their flags, and all findings."""
    flags: Flags
    """Flags of all rows, shape (n,)."""
    whole: frozenset[str]
    """Roles of channels with whole counts throughout."""
    peaks: Mapping[str, float]
    """Role -> highest value [SI] of the samples without serious flags."""
    period: float
    """Median sampling period [s]."""
    rows: np.ndarray | None = None
    """Row in the file of each row for cutting; None where all rows are used."""

    def placed(self, found: list[Found]) -> list[Found]:
        """Findings in the rows for cutting, with their row numbers changed to those of the file."""
        rows = self.rows
        if rows is None:
            return found
        last = len(rows) - 1
        return [_moved(each, lambda row: int(rows[min(row, last)])) for each in found]


def parts(rows: int) -> Iterator[tuple[int, int]]:
    """Begin and end of each part."""
    for begin in range(0, rows, PART):
        yield begin, min(begin + PART, rows)


def inspected(
    table: Table,
    rules: ImportMap,
    inspect: Callable[[Table], Seen],
    summarise: Callable[[Seen], tuple[frozenset[str], Mapping[str, float]]],
) -> Inspected:
    """Inspect all rows, in parts if there are more than `PART`.

    `summarise` gives the roles with whole counts, and the peaks, of inspected rows.
    """
    rows = len(table)
    if rows <= PART:
        seen = inspect(table.part(0, rows))
        return Inspected(seen, seen.flags, *summarise(seen), _period(seen.t))
    flags, merged = np.zeros(rows, dtype=np.uint16), _Findings()
    kept, where, periods = list[Seen](), list[np.ndarray](), list[float]()
    wholes, peaks = list[frozenset[str]](), dict[str, float]()
    for begin, end in parts(rows):
        early = max(0, begin - BEFORE)
        seen = inspect(table.part(early, end))
        doubled = bool(seen.flags[: begin - early].any())
        merged.add(seen.found, early, inspect(table.part(early, begin)).found if doubled else [])
        core = _slice(seen, slice(begin - early, None))
        flags[begin:end] = core.flags
        counts, highest = summarise(core)
        wholes.append(counts)
        for role, value in highest.items():
            peaks[role] = max(value, peaks.get(role, value))
        periods.append(_period(core.t))
        thinned = _thinned(core, rules, max(2, (end - begin) * STRETCHES // rows))
        where.append(begin + thinned)
        kept.append(_slice(core, thinned))
    seen = replace(_joined(kept), found=merged.all())
    whole = wholes[0].intersection(*wholes)
    return Inspected(seen, flags, whole, peaks, float(np.median(periods)), np.concatenate(where))


def _period(t: Array) -> float:
    return float(np.median(np.abs(np.diff(t)))) if len(t) > 1 else 0.0


def _slice(seen: Seen, rows: slice | np.ndarray) -> Seen:
    return Seen(
        seen.t[rows],
        tuple(Checked(channel.rule, channel.raw[rows], channel.si[rows]) for channel in seen.checked),
        {role: values[rows] for role, values in seen.values.items()},
        seen.flags[rows],
        seen.found,
    )


def _joined(kept: list[Seen]) -> Seen:
    t, flags = np.concatenate([seen.t for seen in kept]), np.concatenate([seen.flags for seen in kept])
    values = {role: np.concatenate([seen.values[role] for seen in kept]) for role in kept[0].values}
    raw = (np.concatenate([one.raw for one in same]) for same in zip(*(seen.checked for seen in kept), strict=True))
    rules = (channel.rule for channel in kept[0].checked)
    checked = tuple(Checked(rule, one, values[rule.role]) for rule, one in zip(rules, raw, strict=True))
    return Seen(t, checked, values, flags, [])


def _thinned(seen: Seen, rules: ImportMap, stretches: int) -> np.ndarray:
    """Rows that keep the features by which trials are cut."""
    rows = len(seen.t)
    keep = np.zeros(rows, dtype=bool)
    keep[[0, -1]] = True
    size = -(-rows // stretches)
    for role in {"pressure", "pressure_command", "displacement", "displacement_command"} & seen.values.keys():
        values = seen.values[role]
        padded = np.pad(np.nan_to_num(values, nan=float(np.nanmedian(values))), (0, -rows % size), mode="edge")
        blocks = padded.reshape(-1, size)
        first = np.arange(len(blocks)) * size
        for at in (blocks.argmin(axis=1), blocks.argmax(axis=1)):
            keep[np.minimum(first + at, rows - 1)] = True
    edges = np.abs(np.diff(seen.t)) > min(rules.file.sampling.gap, rules.trials.longer_than or np.inf)
    edges |= np.diff(seen.t) < 0
    for role, values in seen.values.items():
        if role.endswith("command") and rules.trials.smallest:
            edges |= np.abs(np.diff(values)) >= rules.trials.smallest
        elif role in ("phase", "trial"):
            edges |= np.diff(values) != 0
    keep[:-1] |= edges
    keep[1:] |= edges
    return np.flatnonzero(keep)


class _Findings:
    """Merges findings of parts: one of each kind and channel, counted over the whole file."""

    def __init__(self) -> None:
        self._all: dict[tuple[str, str], list[Found]] = {}
        self._parts = 0

    def add(self, found: list[Found], begin: int, before: list[Found]) -> None:
        """Add the findings of a part whose first row is `begin` of the file, without those of the rows before it."""
        self._parts += 1
        counted = {(each.kind, each.channel): each.count for each in before}
        for each in found:
            key = (each.kind, each.channel)
            left = each.count - counted.get(key, 0)
            if (left > 0 or not each.count) and not (each.kind in OF_WHOLE and key in self._all):
                self._all.setdefault(key, []).append(replace(_moved(each, lambda row: row + begin), count=left))

    def all(self) -> list[Found]:
        """The first finding of each kind and channel, with the highest level and the total count."""
        merged = []
        for same in self._all.values():
            first, count = same[0], sum(each.count for each in same)
            level = max((each.level for each in same), key=("note", "doubt", "fault").index)
            text = first.text
            if len(same) > 1:
                text += f"; in {len(same)} of the {self._parts} parts in which the file was looked at"
                text += f", {count:,} samples in all" if count else ""
            merged.append(replace(first, level=level, text=text, count=count))
        return merged


def _moved(found: Found, row_of: Callable[[int], int]) -> Found:
    """A finding with its row numbers converted by `row_of` (from 0); in its text rows count from 1."""

    def named(match: re.Match[str]) -> str:
        first, *last = (str(row_of(int(row) - 1) + 1) for row in match.group(2, 3) if row)
        return " to ".join([f"{match[1]} {first}", *last])

    return replace(found, text=_ROW.sub(named, found.text), index=None if found.index is None else row_of(found.index))
