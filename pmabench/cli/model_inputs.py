"""Inputs of a model as people give them, with all errors at once, and columns of its values as a table or as CSV.

The muscle of an analysis of kind surface is a model, too.
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Container, Mapping, Sequence
from itertools import product
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.base.quantities import QUANTITIES, show
from pmabench.cli.common import Problems, Ui
from pmabench.report.terminal import print_grid

if TYPE_CHECKING:
    from pmabench.model.library import Model, Parameter
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
    parameters, problems = {p.name: p for p in model.parameters}, Problems()
    given: dict[str, Any] = {}
    table: dict[str, Any] = {}
    for word, asked, into, read in ((option, settings, given, _value), ("--over", axes, table, _axis)):
        for key, text in asked:
            with problems.of(f"{word} {key}"):
                if key not in parameters:
                    raise ValueError(f'{model.name} has no input "{key}"{did_you_mean(key, parameters)}')
                if key in given or key in table:
                    raise ValueError("given twice")
                into[key] = read(parameters[key], text)
    rows = math.prod(len(axis) for axis in table.values())
    if rows > MOST_ROWS:
        problems.append(f"--over: {rows} rows; at most {MOST_ROWS} are made")
    problems.refuse()
    return given, table


def shown(parameter: Parameter, value: object, digits: int = 6) -> str:
    """An input in the unit that people read."""
    return value if isinstance(value, str) else show(float(value), parameter.quantity, digits)  # type: ignore[arg-type]


def print_settings(
    width: int, model: Model, inputs: Mapping[str, Any], given: Container[str], others: str, idle: Container[str] = ()
) -> None:
    """Inputs of a model: those that were `given`, then the others but the idle ones; `others` says what they are."""
    known = {p.name: p for p in model.parameters}
    mine = [f"{key} {shown(known[key], value)}" for key, value in inputs.items() if key in given]
    rest = [
        f"{key} {shown(known[key], value)}" for key, value in inputs.items() if key not in given and key not in idle
    ]
    for word, settings in (("given", mine), (others, rest)):
        if settings:
            text = f"{word}: {', '.join(settings)}"
            click.echo(fill(text, width, subsequent_indent="  ", break_on_hyphens=False))


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


Column = Mapping[str, Any]
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


def print_table(ui: Ui, columns: Sequence[Column], keys: int) -> None:
    """The columns in display units; the first `keys` of them are repeated in every part of a table that is too wide."""
    heads = [f"{column['name']} {display_unit(column['quantity'])}".strip() for column in columns]
    texts = [head for head, column in zip(heads, columns, strict=True) if not column["quantity"]]
    print_grid(ui.console(), heads, list(zip(*map(_cells, columns), strict=True)), texts, keys)


def _cells(column: Column) -> list[str]:
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


def print_csv(columns: Sequence[Column]) -> None:
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
