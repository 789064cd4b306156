"""What people give to a model, inputs and tables of measured rows; columns of its values as a table or as CSV.

All errors are named at once. The muscle of an analysis of kind surface is a model, too.
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from itertools import product
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import InvalidFile, UsageError, did_you_mean
from pmabench.base.quantities import QUANTITIES, show
from pmabench.cli.common import Ui
from pmabench.files.table import Column, Table, Wanted, meaning, numbers, read_table, split_head
from pmabench.report.terminal import print_grid

if TYPE_CHECKING:
    from pmabench.model.curve import Array
    from pmabench.model.library import Model, Parameter
    from pmabench.model.library.description import Output
    from pmabench.model.presets import Described
    from pmabench.model.regulator import Regulator
    from pmabench.store.analyses.results import Analysis

MOST_ROWS = 20_000


def pairs(_context: click.Context, _parameter: click.Parameter, values: tuple[str, ...]) -> list[tuple[str, str]]:
    """`NAME=VALUE` options as (name, value)."""
    for value in values:
        if value.strip().find("=") < 1:
            raise click.BadParameter(f'"{value}" is not name=value, for instance "pressure=300 kPa"')
    return [(name.strip(), text.strip()) for name, _, text in (value.partition("=") for value in values)]


def named_model(name: str) -> Model:
    """The model of the library, or the muscle of an analysis by its folder; UsageError with the nearest name."""
    from pmabench.model.library import models

    known = models()
    if name not in known and Path(name).is_dir():
        return surface_model(Path(name))
    if name not in known:
        raise UsageError(f'no model "{name}"{did_you_mean(name, known)}')
    return known[name]


def read_inputs(
    model: Model, settings: list[tuple[str, str]], axes: list[tuple[str, str]], option: str = "--set"
) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """Values given by `option` and the axes of the table; UsageError with everything that is wrong."""
    parameters = {p.name: p for p in model.parameters}
    given: dict[str, Any] = {}
    table: dict[str, list[Any]] = {}
    problems: list[str] = []
    for word, asked in ((option, settings), ("--over", axes)):
        for key, text in asked:
            if key not in parameters:
                problems.append(f'{word} {key}: {model.name} has no input "{key}"{did_you_mean(key, parameters)}')
            elif key in given or key in table:
                problems.append(f"{word} {key}: given twice")
            else:
                try:
                    if word == option:
                        given[key] = _value(parameters[key], text)
                    else:
                        table[key] = _axis(parameters[key], text)
                except ValueError as error:
                    problems.append(f"{word} {key}: {error}")
    rows = math.prod(len(axis) for axis in table.values())
    if rows > MOST_ROWS:
        problems.append(f"--over: {rows} rows; at most {MOST_ROWS} are made")
    if problems:
        raise UsageError("\n".join(problems))
    return given, table


def shown(parameter: Parameter, value: object, digits: int = 6) -> str:
    """An input in the unit that people read."""
    return value if isinstance(value, str) else show(float(value), parameter.quantity, digits)  # type: ignore[arg-type]


def _value(parameter: Parameter, text: str) -> float | str:
    """One value [SI], or the name of a choice; ValueError that says what is expected."""
    choices = parameter.choices
    if choices and text not in choices:
        raise ValueError(f'"{text}" is none of {", ".join(choices)}{did_you_mean(text, choices)}')
    return text if choices else number_of(text, parameter.quantity)


def number_of(text: str, quantity: str) -> float:
    """One number [SI]; ValueError that says what is expected."""
    from pmabench.files.quantity import parse_quantity

    if quantity == "count":
        try:
            return float(text)
        except ValueError:
            raise ValueError(f'"{text}" is no number; a pure number is expected, for instance "1.2"') from None
    if quantity == "pressure" and "(" in text:
        raise ValueError(f'"{text}": pressures of models are gauge, the atmosphere alone is absolute; write "300 kPa"')
    return parse_quantity(text, quantity)


def _axis(parameter: Parameter, text: str) -> list[Any]:
    first, dots, rest = text.partition("..")
    if not dots:
        return [_value(parameter, part.strip()) for part in text.split(",")]
    last, by, step_text = rest.partition(" by ")
    if parameter.choices or not by:
        raise ValueError(f'"{text}" is no range; write "FIRST..LAST by STEP", or a list "A, B, C"')
    start, stop, step = (float(_value(parameter, part.strip())) for part in (first, last, step_text))
    if not all(map(math.isfinite, (start, stop, step))) or step <= 0:
        raise ValueError(f'"{text}": the step must be above zero')
    count = abs(stop - start) / step
    if count > MOST_ROWS:
        raise ValueError(f"makes {count + 1:.0f} values; at most {MOST_ROWS} are made")
    if abs(count - round(count)) > 1e-6:
        raise ValueError(f'"{text}": the step does not lead from the first to the last value in whole steps')
    sign = 1.0 if stop >= start else -1.0
    values = [start + sign * index * step for index in range(round(count) + 1)]
    values[-1] = stop
    return values


def grid(
    model: Model, given: dict[str, Any], table: dict[str, list[Any]]
) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """Every single input, and the columns of the table: all combinations of its axes."""
    inputs = {p.name: given.get(p.name, p.value) for p in model.parameters if p.name not in table}
    columns = zip(*product(*table.values()), strict=True)
    return inputs, {name: list(column) for name, column in zip(table, columns, strict=True)}


Shown = Mapping[str, Any]
"""`name`, `quantity`, `values` (numbers in SI, None where not finite, or names); `unit` for CSV."""


def column_of(name: str, quantity: str, values: Sequence[Any]) -> dict[str, Any]:
    """A column with its SI unit, as it is in JSON too."""
    return {"name": name, "quantity": quantity, "unit": si_unit(quantity), "values": values}


def show_columns(
    ui: Ui, data: dict[str, Any], *, keys: int = 1, as_csv: bool, above: str = "", below: Sequence[str] = ()
) -> None:
    """The result `data`, whose `columns` people see as CSV, or as a table between texts; --quiet drops the first."""

    def human() -> None:
        if as_csv:
            print_csv(data["columns"])
            return
        if above and not ui.quiet:
            click.echo(f"{above}\n")
        print_table(ui, data["columns"], keys)
        for line in below:
            click.echo(line)

    ui.result(data, human)


def print_table(ui: Ui, columns: Sequence[Shown], keys: int) -> None:
    """The columns in display units; the first `keys` of them are repeated in every part of a table that is too wide."""
    heads = [f"{column['name']} {display_unit(column['quantity'])}".strip() for column in columns]
    texts = [head for head, column in zip(heads, columns, strict=True) if not column["quantity"]]
    print_grid(ui.console(), heads, list(zip(*map(_cells, columns), strict=True)), texts, keys)


def _cells(column: Shown) -> list[str]:
    """Texts of a column's values; what is negligible against the largest is 0."""
    numbers = [value if isinstance(value, float) else None for value in column["values"]]
    least = 1e-9 * max((abs(number) for number in numbers if number is not None), default=0.0)
    values = zip(column["values"], numbers, strict=True)
    return [cell(column["quantity"], 0.0 if n is not None and abs(n) < least else value) for value, n in values]


def cell(quantity: str, value: float | str | None) -> str:
    """One value without its unit."""
    if value is None or isinstance(value, str):
        return value or ""
    return f"{value / QUANTITIES[quantity].scale:.6g}"


def display_unit(quantity: str) -> str:
    """The unit that people read."""
    return QUANTITIES[quantity].shown_in if quantity else ""


def si_unit(quantity: str) -> str:
    """The SI unit; "1" for a pure number."""
    return QUANTITIES[quantity].unit if quantity else ""


def print_csv(columns: Sequence[Shown]) -> None:
    """Print columns as CSV, SI values with all digits; heads are `name [unit]`."""
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow([f"{c['name']} [{c['unit']}]" if c["unit"] else c["name"] for c in columns])
    for row in zip(*(c["values"] for c in columns), strict=True):
        writer.writerow(["" if value is None else value if isinstance(value, str) else repr(value) for value in row])


def analysis_of(folder: Path) -> Analysis:
    """The analysis in a folder, or the first inside it, that holds a muscle as a surface; else UsageError."""
    from pmabench.model.identified.library import holds_surface
    from pmabench.store.analyses.folder import analyses_below, read_analysis

    analyses = [read_analysis(one) for one in analyses_below(folder)]
    able = [one for one in analyses if holds_surface(one.facts)]
    if not able:
        kinds = ", ".join(sorted({one.kind for one in analyses})) or "no analysis"
        raise UsageError(
            f"{folder} holds {kinds}, and no muscle as a surface: give the folder of an analysis that was made with "
            '"pmabench process RUN... --form surface"'
        )
    return able[0]


def described_by(folder: Path, regulator: Regulator) -> Described:
    """The muscle of `analysis_of` a folder behind a regulator."""
    from pmabench.model.identified.library import described

    analysis = analysis_of(folder)
    try:
        return described(analysis.facts, f"analysis of {', '.join(analysis.runs)}", regulator)
    except ValueError as error:
        raise UsageError(f"{folder}: {error}") from error


def surface_model(folder: Path) -> Model:
    """The muscle of `analysis_of` a folder as a model of the library, with how well it predicts."""
    from pmabench.model.identified.library import as_model
    from pmabench.model.regulator import Regulator

    known, facts = described_by(folder, Regulator()), analysis_of(folder).facts
    left_out, lines = (show(facts[name], "force", 2) for name in ("held_out_rms", "straight_form_rms"))
    note = f"Trials that were left out of the fit were predicted to {left_out} rms; by straight lines to {lines}."
    assert known.surface is not None  # noqa: S101  (`described` makes it)
    return as_model(known.surface, str(folder), known.source, note)


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
    given: Sequence[str],
) -> Measured:
    """The inputs and the one output that the table has; rows count between the `ranges` of inputs and output [SI].

    A folder is an analysis: its table of coefficients. Raises UsageError, InvalidFile.
    """
    notes: list[str] = []
    table = read_table(path / "coefficients.csv" if path.is_dir() else path)
    inputs, outputs, unused, problems = _columns(model, table)
    if problems:
        raise InvalidFile(problems)
    twice = [name for name in inputs if name in given]
    if twice:
        raise UsageError(f"--set {twice[0]}: {table.path} has a column of it; give one or the other")
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
    names = list(inputs)
    quantities = {p.name: p.quantity for p in model.parameters} | {o.name: o.quantity for o in model.outputs}
    read = [*inputs.items(), (chosen, outputs[chosen])]
    chosen_columns = [(column, quantities[name], unit) for name, (column, unit) in read]
    for item, quantity, unit in chosen_columns:
        if quantity == "ratio" and unit in (None, ""):
            notes.append(f'column "{item.head.text}" has no unit: taken as a fraction, not in %')
    limits = [ranges.get(name, (-inf, inf)) for name, _ in read]
    ends = [(low - 1e-9 * abs(low), high + 1e-9 * abs(high)) for low, high in limits]  # room for rounding of units
    known = {p.name: p for p in model.parameters}
    for name in ranges:
        if name not in (*names, chosen):
            raise UsageError(f"--within {name}: {table.path} has no column of it")
    found, kept = numbers(
        table,
        chosen_columns,
        lambda place, value: _outside(known[names[place]], value) if place < len(names) else "",
        lambda place, value: ends[place][0] <= value <= ends[place][1],
    )
    count = len(table.columns[0].cells)
    if not kept:
        raise UsageError(f"{table.path}: no row has a value in each of {', '.join([*names, chosen])} that counts")
    columns = dict(zip(names, found[:-1], strict=True))
    halves = _halves(table, chosen_columns[-1], kept, notes)
    return Measured(chosen, columns, found[-1], halves, count - len(kept), notes, table.source)


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


Found = dict[str, tuple[Column, str | None]]


def columns_of(model: Model, table: Table) -> tuple[Found, list[str]]:
    """Columns of inputs by name with their units, and the heads of all other columns. Raises InvalidFile."""
    inputs, outputs, unused, problems = _columns(model, table)
    if problems:
        raise InvalidFile(problems)
    return inputs, [*unused, *(column.head.text for column, _ in outputs.values())]


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


def _columns(model: Model, table: Table) -> tuple[Found, Found, list[str], list[Any]]:
    """Columns of inputs and outputs by name with their units, heads that are neither, and problems."""
    inputs: Found = {}
    outputs: Found = {}
    unused: list[str] = []
    problems: list[Any] = []
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
    return inputs, outputs, unused, problems


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
    inputs, outputs, _, _ = _columns(model, table)
    method_column = next((column for column in table.columns if column.name == "method"), None)
    if method_column is not None:
        has = zip(method_column.cells, outputs[chosen][0].cells, strict=True)
        given = list(dict.fromkeys(method.text for method, cell in has if cell.text))
        if len(given) > 1:
            others = ", ".join(given[1:])
            notes.append(f'method "{given[0]}"; there are also: {others}; for these give a CSV with their rows')
            rows = [row for row, cell in enumerate(method_column.cells) if cell.text == given[0]]
            columns = (replace(column, cells=tuple(column.cells[row] for row in rows)) for column in table.columns)
            table = replace(table, columns=tuple(columns))
            inputs, outputs, _, _ = _columns(model, table)
    return table, inputs, outputs


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
