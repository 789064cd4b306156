"""Measured rows for a fit: which column of a table is which input or output of a model."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from itertools import compress
from math import inf
from pathlib import Path

from pmabench.base.errors import InvalidFile, Problem, UsageError, did_you_mean
from pmabench.base.quantities import QUANTITIES, show
from pmabench.files.table import Column, Table, Wanted, meaning, numbers, read_table, split_head
from pmabench.model.curve import Array
from pmabench.model.library import Model, Parameter
from pmabench.model.library.description import Output

SYNONYMS = {
    "pressure": ("P", "p"),
    "contraction": ("eps", "h"),
    "displacement": ("x",),
    "force": ("F",),
    "stiffness": ("K", "S"),
    "damping": ("B", "D"),
    "length": ("L",),
    "volume": ("V",),
    "time": ("t",),
    "angle": ("alpha",),
}
"""Other heads for an input or output of this name, where the model calls nothing else so."""


HALF = " half width 95 %"
"""End of the head of a column that holds the half widths of the column before it."""
CLOSE = 0.8
"""Likeness from which on an unknown head counts as a slip of the pen and not as another column."""


@dataclass(frozen=True)
class Measured:
    """The rows of a table as a model takes them, SI."""

    output: str
    columns: dict[str, Array]
    """Inputs by name."""
    values: Array
    """What was measured of the output."""
    halves: Array | None
    """95 % half widths of these values, where the table has a column of them."""
    left_out: int
    """Rows with an empty cell or outside of the ranges."""
    notes: list[str]
    source: str


def read_measured(
    model: Model,
    path: Path,
    *,
    output: str | None,
    ranges: Mapping[str, tuple[float, float]],
    given: Collection[str],
) -> Measured:
    """The inputs and the one output that the table has; rows count between the `ranges` of inputs and output [SI].

    A folder is an analysis: its table of coefficients. Raises UsageError, InvalidFile.
    """
    notes: list[str] = []
    table = read_table(path / "coefficients.csv" if path.is_dir() else path)
    inputs, outputs, unused = columns_of(model, table, given)
    chosen = _chosen_output(model, table, outputs, output)
    if not inputs:
        expected = ", ".join(_example(p.name, p.quantity) for p in model.parameters if not p.choices)
        raise UsageError(f"{table.path} has no column of an input of {model.name}; it takes: {expected}")
    idle = [*unused, *(other.head.text for name, (other, _) in outputs.items() if name != chosen)]
    idle = [head for head in idle if not split_head(head)[0].endswith(HALF)]
    if idle and not path.is_dir():
        notes.append("not used: column " + ", ".join(f'"{head}"' for head in idle))
    if path.is_dir():
        table, inputs, outputs = _one_method(model, table, chosen, notes)
    known = {p.name: p for p in model.parameters}
    quantities = {name: p.quantity for name, p in known.items()} | {o.name: o.quantity for o in model.outputs}
    names = [*inputs, chosen]
    read = [(column, quantities[name], unit) for name, (column, unit) in (inputs | {chosen: outputs[chosen]}).items()]
    for item, quantity, unit in read:
        if quantity == "ratio" and unit in (None, ""):
            notes.append(f'column "{item.head.text}" has no unit: taken as a fraction, not in %')
    limits = [ranges.get(name, (-inf, inf)) for name in names]
    ends = [(low - 1e-9 * abs(low), high + 1e-9 * abs(high)) for low, high in limits]  # room for rounding of units
    if lacking := [name for name in ranges if name not in names]:
        raise UsageError(f"--within {lacking[0]}: {table.path} has no column of it")
    found, kept = numbers(
        table,
        read,
        lambda place, value: _outside(known[names[place]], value) if place < len(inputs) else "",
        lambda place, value: ends[place][0] <= value <= ends[place][1],
    )
    if not kept:
        raise UsageError(f"{table.path}: no row has a value in each of {', '.join(names)} that counts")
    *columns, values = found
    left_out = len(table.columns[0].cells) - len(kept)
    halves = _halves(table, read[-1], kept, notes)
    return Measured(chosen, dict(zip(inputs, columns, strict=True)), values, halves, left_out, notes, table.source)


def _halves(
    table: Table, measured: tuple[Column, str, str | None], kept: Sequence[int], notes: list[str]
) -> Array | None:
    """Half widths of the measured column at the rows that count, as `process` writes them; None without a column."""
    column, quantity, unit = measured
    wide = next((one for one in table.columns if one.name == f"{column.name}{HALF}"), None)
    if wide is None:
        return None
    (every,), _ = numbers(table, [(wide, quantity, wide.unit or unit)], blank=True)
    halves = every[list(kept)]
    halves[~(halves > 0)] = 0.0
    notes.append(f'intervals hold those of column "{wide.head.text}"')
    if lacking := int((halves == 0).sum()):
        notes.append(f"{lacking} rows have no half width: their values count as exact but for the scatter")
    return halves


Found = dict[str, tuple["Column", "str | None"]]


def _chosen_output(model: Model, table: Table, outputs: Found, wanted: str | None) -> str:
    """The output to read: the wanted one, else the only one of the table. Raises UsageError."""
    if wanted is not None and wanted not in outputs:
        known = outputs or [o.name for o in model.outputs]
        raise UsageError(f"--output {wanted}: {table.path} has no column of it{did_you_mean(wanted, known)}")
    if not outputs:
        expected = ", ".join(_example(o.name, o.quantity) for o in model.outputs)
        raise UsageError(f"{table.path} has no column of an output of {model.name}; expected is one of: {expected}")
    if wanted is None and len(outputs) > 1:
        raise UsageError(
            f"{table.path} has several outputs of {model.name}: {', '.join(outputs)}; choose with --output"
        )
    return wanted or next(iter(outputs))


def columns_of(model: Model, table: Table, given: Collection[str] = ()) -> tuple[Found, Found, list[str]]:
    """Columns of inputs and outputs by name with their units, and heads that are neither.

    Raises InvalidFile, and UsageError for an input that is `given`, too.
    """
    inputs: Found = {}
    outputs: Found = {}
    unused: list[str] = []
    problems: list[Problem] = []
    wanted = _wanted(model)
    names = [item.names[0] for item in wanted]
    own = {p.name for p in model.parameters}
    for column in table.columns:
        if not any(cell.text for cell in column.cells):
            continue  # of an analysis that does not know it
        item = meaning(column, wanted)
        if item is None:
            if near := get_close_matches(column.name, names, n=1, cutoff=CLOSE):
                problem = f'"{column.name}" is no input or output; did you mean "{near[0]}"?'
                problems.append(table.problem(column.head, problem))
            unused.append(column.head.text)
            continue
        name, unit = item[0].names[0], item[1]
        into = inputs if name in own else outputs
        if name in into:
            problems.append(table.problem(column.head, f"a second column of {name}"))
        into[name] = (column, unit)
    if problems:
        raise InvalidFile(problems)
    if twice := [name for name in inputs if name in given]:
        raise UsageError(f"--set {twice[0]}: {table.path} has a column of it; give one or the other")
    return inputs, outputs, unused


def _wanted(model: Model) -> list[Wanted]:
    """Names and symbols of inputs, then of outputs; a symbol that two share counts for none."""
    inputs = [p for p in model.parameters if not p.choices]
    own = {p.name for p in inputs}
    everything: list[Parameter | Output] = [*inputs, *(o for o in model.outputs if o.name not in own)]
    used = [name for item in everything for name in (item.name, item.symbol) if name]
    found = []
    for item in everything:
        symbol = [item.symbol] if item.symbol and used.count(item.symbol) == 1 else []
        others = [other for other in SYNONYMS.get(item.name, ()) if other not in used]
        found.append(Wanted((item.name, *symbol, *others), item.quantity))
    return found


def _one_method(model: Model, table: Table, chosen: str, notes: list[str]) -> tuple[Table, Found, Found]:
    """An analysis' table has a row per method: the first that gives the output."""
    methods = next((column.cells for column in table.columns if column.name == "method"), ())
    has = zip(methods, columns_of(model, table)[1][chosen][0].cells, strict=False)
    given = list(dict.fromkeys(method.text for method, cell in has if cell.text))
    if len(given) > 1:
        others = ", ".join(given[1:])
        notes.append(f'method "{given[0]}"; there are also: {others}; for these give a CSV with their rows')
        mine = [cell.text == given[0] for cell in methods]
        columns = (replace(column, cells=tuple(compress(column.cells, mine))) for column in table.columns)
        table = replace(table, columns=tuple(columns))
    return table, *columns_of(model, table)[:2]


def _outside(p: Parameter, value: float) -> str:
    """Why an input's value is outside the model's domain, or nothing."""
    room = 1e-12
    low = value <= p.low if p.above else value < p.low - room * abs(p.low)
    if not low and value <= p.high + room * abs(p.high):
        return ""
    ends = [show(end, p.quantity) if abs(end) < float("inf") else "" for end in (p.low, p.high)]
    start = f"above {ends[0]}" if p.above else f"from {ends[0]}" if ends[0] else ""
    interval = " ".join(part for part in (start, f"to {ends[1]}" if ends[1] else "") if part)
    reason = f": {p.reason}" if p.reason else ""
    return f"{show(value, p.quantity)} is outside the model's domain, {interval}{reason}"


def _example(name: str, quantity: str) -> str:
    unit = QUANTITIES[quantity].shown_in if quantity else ""
    return f'"{name} [{unit}]"' if unit else f'"{name}"'
