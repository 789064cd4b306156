"""`report --overlay FILE.csv[:LABEL]`: published tables read with their units, for the figures that they match."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pmabench.base.errors import InvalidFile, Problem, UsageError, invalid
from pmabench.base.quantities import QUANTITIES
from pmabench.files.table import Column, Wanted, meaning, numbers, read_table, unit_scale
from pmabench.report.figures.overlays import COORDINATES, HEADS, Published


def read_overlays(given: Sequence[str]) -> list[Published]:
    """The tables of `FILE[:LABEL]`; InvalidFile with every head and cell that is wrong, of all files."""
    found, problems = [], list[Problem]()
    for text in given:
        path, label = _parted(text)
        try:
            found.append(_read(path, label))
        except InvalidFile as error:
            problems += error.problems
    if problems:
        raise InvalidFile(problems)
    names = [table.label for table in found]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise UsageError(f'--overlay: two are called "{twice[0]}"; give labels, FILE.csv:LABEL')
    return found


def _parted(text: str) -> tuple[Path, str]:
    """File and label; a colon in the name of a file that is there is no label."""
    if Path(text).exists():
        return Path(text), Path(text).stem
    name, colon, label = text.rpartition(":")
    if not colon:
        return Path(text), Path(text).stem
    return Path(name), label.strip() or Path(name).stem


def _read(path: Path, label: str) -> Published:
    table = read_table(path)
    chosen: dict[str, tuple[Column, str, str | None]] = {}
    problems = []
    for column in table.columns:
        found = _meaning(column)
        if found is None:
            continue
        name, quantity, unit = found
        if name in chosen:
            problems.append(table.problem(column.head, f"a second column of {name}"))
        chosen[name] = (column, quantity, unit)
    if problems:
        raise InvalidFile(problems)
    values = [name for name in chosen if name not in COORDINATES]
    if not values or len(values) == len(chosen):
        heads = ", ".join(f'"{names[0]} [{QUANTITIES[quantity].shown_in}]"' for _, quantity, names in HEADS)
        raise invalid(
            path, f"a coordinate and a value over it are expected, of: {heads}", table.columns[0].head.line, 1
        )
    columns, _ = numbers(table, list(chosen.values()), blank=True)
    return Published(label, table.source, path, dict(zip(chosen, columns, strict=True)))


def _meaning(column: Column) -> tuple[str, str, str | None] | None:
    """Name, quantity and unit of a column: the first of its meanings whose unit fits, else the first."""
    able = []
    for name, quantity, heads in HEADS:
        found = meaning(column, [Wanted(heads, quantity)])
        if found is not None:
            able.append((name, quantity, found[1]))
    for name, quantity, unit in able:
        try:
            unit_scale(unit, quantity)
        except ValueError:
            continue
        return name, quantity, unit
    return able[0] if able else None
