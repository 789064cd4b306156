"""`pmabench model`: the library of models: what there is, what each says, and its values.

Values over ranges of inputs, or at each row of a table of measured inputs with the uncertainty that they bring.
"""

from __future__ import annotations

import math
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.cli.cascade import command as cascade
from pmabench.cli.common import Group, Problems, Ui, common, fields
from pmabench.cli.model_fit import fit
from pmabench.cli.model_inputs import (
    cell,
    column_of,
    display_unit,
    grid,
    named_model,
    number_of,
    pairs,
    print_csv,
    print_settings,
    print_table,
    read_inputs,
    show_columns,
    shown,
    si_unit,
)
from pmabench.cli.model_simulate import simulate
from pmabench.report.terminal import print_grid, print_texts

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pmabench.files.table import Table
    from pmabench.model.library import Model, Parameter
    from pmabench.model.library.description import Reference

    Check = tuple[Reference, float, bool]
    """A reference value, what is computed now, and whether they agree."""


EXAMPLE = '\b\npmabench model eval tondu-lopez --set "pressure=300 kPa" \\\n    --over "contraction=0 %..25 % by 5 %"'


@click.group(name="model", cls=Group)
def command() -> None:
    """Models of muscles, regulators, loads and compositions: list, show, evaluate, simulate, fit."""


command.add_command(simulate)
command.add_command(fit)
command.add_command(cascade)


@command.command(name="list")
@common
def list_models(ui: Ui) -> None:
    """Every model, by family."""
    from pmabench.model.library import FAMILIES, models

    known = sorted(models().values(), key=lambda model: FAMILIES.index(model.family))
    data = {
        "schema": "pmabench.models/1",
        "models": [fields(m, "name", "family", "title", "source") for m in known],
    }

    def human() -> None:
        first = {model.family: model for model in reversed(known)}
        rows = [[m.family if first[m.family] is m else "", m.name, m.title] for m in known]
        print_texts(ui.console(columns=120), ["family", "model", "what it gives"], rows)

    ui.result(data, human, (model.name for model in known))


@command.command(name="show")
@click.argument("name")
@common
def show_model(ui: Ui, name: str) -> None:
    """Equation, inputs with their domain, outputs, source and reference values of the model NAME."""
    model = named_model(name)
    found = [(r, float(model.evaluate(r.at)[r.output])) for r in model.references]
    checks = [(r, now, abs(now - r.value) <= 1.001 * r.rounding + 1e-12 * abs(now)) for r, now in found]
    ui.result(_facts(model, checks), lambda: _print_model(ui, model, checks))


def _facts(model: Model, checks: Sequence[Check]) -> dict[str, Any]:
    """The model as plain data."""
    return {
        "schema": "pmabench.model/1",
        **fields(model, "name", "family", "title", "equation", "source", "fitted", "notes"),
        "inputs": [
            fields(p, "name", "symbol", "quantity", "origin", "choices", "reason", "meaning")
            | {"unit": si_unit(p.quantity), "reference": p.value}
            | {"domain": [end if math.isfinite(end) else None for end in (p.low, p.high)]}
            for p in model.parameters
        ],
        "outputs": [
            fields(o, "name", "symbol", "quantity", "meaning") | {"unit": si_unit(o.quantity)} for o in model.outputs
        ],
        "references": [
            fields(r, "output", "at", "printed", "value", "source")
            | {"printed_unit": r.unit, "computed": now, "agrees": agrees}
            for r, now, agrees in checks
        ],
    }


def _print_model(ui: Ui, model: Model, checks: Sequence[Check]) -> None:
    console = ui.console()
    click.echo(f"{model.name}: {model.title}\n")
    for line in model.equation:
        click.echo(f"  {line}")
    click.echo(f"\nSource: {model.source}.\n")
    rows = []
    for p in model.parameters:
        origin = f" ({p.origin})" if p.origin != "example" else ""
        rows.append([p.name, p.symbol, shown(p, p.value), _domain(p), p.meaning + origin])
    print_texts(console, ["input", "symbol", "reference", "domain", "meaning"], rows)
    if model.fitted:
        click.echo(fill(f"A fit takes as unknown: {', '.join(model.fitted)}.", console.width))
    click.echo()
    rows = [[o.name, o.symbol, display_unit(o.quantity), o.meaning] for o in model.outputs]
    print_texts(console, ["output", "symbol", "unit", "meaning"], rows)
    if checks:
        _print_checks(ui, model, checks)
    click.echo()
    for note in model.notes:
        click.echo(fill(note, console.width, initial_indent="- ", subsequent_indent="  "))


def _print_checks(ui: Ui, model: Model, checks: Sequence[Check]) -> None:
    click.echo()
    parameters = {p.name: p for p in model.parameters}
    rows = []
    for r, now, agrees in checks:
        at = ", ".join(f"{key} = {shown(parameters[key], value)}" for key, value in r.at.items()) or "reference"
        values = [f"{value} {r.unit}".strip() for value in (r.printed, f"{now / r.scale:.7g}")]
        rows.append([r.output, at, *values, "" if agrees else "DIFFERS", r.source])
    heads = ["check", "at", "expected", "computed now", "", "expected from"]
    print_grid(ui.console(), heads, rows, ("check", "at", "", "expected from"))


@command.command(name="eval", epilog=EXAMPLE)
@click.argument("name")
@click.option("--set", "settings", multiple=True, callback=pairs, metavar="NAME=VALUE", help="An input with its unit.")
@click.option(
    "--over",
    "axes",
    multiple=True,
    callback=pairs,
    metavar="NAME=RANGE",
    help='A table over an input: "FIRST..LAST by STEP" or "A, B, C"; repeatable, the first outermost.',
)
@click.option("--csv", "as_csv", is_flag=True, help="Comma-separated values in SI units on stdout.")
@common
def eval_model(
    ui: Ui, name: str, settings: list[tuple[str, str]], axes: list[tuple[str, str]], *, as_csv: bool
) -> None:
    """Values of the model NAME; inputs that are not given are at their reference values."""
    model = named_model(name)
    given, table = read_inputs(model, settings, axes)
    inputs, columns = grid(model, given, table)
    outputs = _evaluate(model, {**given, **columns})
    values: list[tuple[Any, Any]] = [(p, columns[p.name]) for p in model.parameters if p.name in columns]
    values += [(o, outputs[o.name]) for o in model.outputs]
    table_columns = [column_of(item.name, item.quantity, numbers) for item, numbers in values]
    data = {
        "schema": "pmabench.model-eval/1",
        "model": model.name,
        "inputs": {
            p.name: {"value": inputs[p.name], "unit": si_unit(p.quantity), "given": p.name in given}
            for p in model.parameters
            if p.name in inputs
        },
        "columns": table_columns,
    }

    def human() -> None:
        if as_csv:
            print_csv(table_columns)
            return
        if not ui.quiet:
            print_settings(ui.console().width, model, inputs, given, "at their reference values")
            click.echo()
        if columns:
            print_table(ui, table_columns, len(columns))
        else:
            _print_outputs(ui, model, outputs)

    ui.result(data, human)


def _evaluate(model: Model, values: dict[str, Any]) -> dict[str, list[float | None]]:
    """The outputs row by row [SI]; UsageError with the reasons where the model does not hold."""
    import numpy as np

    from pmabench.model.library import OutsideDomain

    parameters = {p.name: p for p in model.parameters}
    names = [name for name in values if parameters[name].choices and isinstance(values[name], list)]
    count = max((len(value) for value in values.values() if isinstance(value, list)), default=1)
    try:
        rows = [{key: v[i] if isinstance(v, list) else v for key, v in values.items()} for i in range(count)]
        found = [model.evaluate(row) for row in (rows if names else [values])]
    except OutsideDomain as error:
        sentences = [_sentence(parameters.get(refusal.name), refusal) for refusal in error.refusals]
        raise UsageError("\n".join(f"{model.name}: {sentence}" for sentence in sentences)) from error
    result: dict[str, list[float | None]] = {}
    for output in model.outputs:
        if names:
            column = np.array([float(row[output.name]) for row in found])
        else:
            column = np.broadcast_to(found[0][output.name], (count,))
        result[output.name] = [float(value) if math.isfinite(value) else None for value in column]
    return result


def _domain(parameter: Parameter) -> str:
    """The range in words."""
    if parameter.choices:
        return " or ".join(parameter.choices)
    low, high = (shown(parameter, value) for value in (parameter.low, parameter.high))
    if not math.isfinite(parameter.low):
        return "any" if not math.isfinite(parameter.high) else f"up to {high}"
    start = f"above {low}" if parameter.above else low
    if not math.isfinite(parameter.high):
        return start if parameter.above else f"from {low}"
    return f"{start} to {high}"


def _sentence(parameter: Parameter | None, refusal: Any) -> str:
    if parameter is None or math.isnan(refusal.value):
        return f"{refusal.name}: {refusal.reason}"
    if math.isnan(refusal.low):
        return f"{refusal.name} = {shown(parameter, refusal.value)}: {refusal.reason}"
    reason = f": {refusal.reason}" if refusal.reason else ""
    return f"{refusal.name} = {shown(parameter, refusal.value)} is outside its domain, {_domain(parameter)}{reason}"


def _print_outputs(ui: Ui, model: Model, outputs: dict[str, list[float | None]]) -> None:
    heads = ["output", "symbol", "value", "unit", "meaning"]
    rows = [
        [o.name, o.symbol, cell(o.quantity, outputs[o.name][0]), display_unit(o.quantity), o.meaning]
        for o in model.outputs
    ]
    print_grid(ui.console(), heads, rows, ("output", "symbol", "unit", "meaning"))


ROWS_EXAMPLE = (
    "\b\npmabench model rows three-cylinder-volume diameters.csv \\\n"
    '    --set "thickness=1.5 mm" --uncertainty "thickness=0.05 mm" \\\n'
    '    --uncertainty "diameter_1, diameter_2, diameter_3=0.1 mm"'
)
Groups = list[tuple[tuple[str, ...], float]]
"""Inputs that are off together, and by how much [SI]: half widths of 95 % intervals."""


@command.command(name="rows", epilog=ROWS_EXAMPLE)
@click.argument("name")
@click.argument("table", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("--set", "settings", multiple=True, callback=pairs, metavar="NAME=VALUE", help="An input of all rows.")
@click.option(
    "--uncertainty", "unsure", multiple=True, callback=pairs, metavar="NAMES=VALUE",
    help="Half width of the 95 % interval of an input; of several, with commas, that one gauge measures.",
)  # fmt: skip
@click.option("--csv", "as_csv", is_flag=True, help="Comma-separated values in SI units on stdout.")
@common
def eval_rows(
    ui: Ui, name: str, table: Path, settings: list[tuple[str, str]], unsure: list[tuple[str, str]], *, as_csv: bool
) -> None:
    """Values of the model NAME at each row of the CSV file TABLE, whose heads are inputs with their units.

    Every input is in the table or given; other columns are repeated as they are. Uncertainties are carried through to
    first order: inputs in one option are off together, options are independent of each other.
    """
    from pmabench.files.table import read_table

    model = named_model(name)
    given, _ = read_inputs(model, settings, [])
    read = read_table(table)
    inputs, others = _inputs(model, read, given)
    count = len(read.columns[0].cells)
    groups = _groups(model, unsure)
    values, halves = _evaluated(model, inputs, groups, count)
    columns = others
    for output in model.outputs:
        columns.append(column_of(output.name, output.quantity, values[output.name].tolist()))
        if groups:
            columns.append(column_of(f"{output.name}_half", output.quantity, halves[output.name].tolist()))
    known = {one for names, _ in groups for one in names}
    exact = [p.name for p in model.parameters if p.name not in known and not p.choices]
    notes = [f"no uncertainty is given of {', '.join(exact)}: it is in no interval"] if groups and exact else []
    data = {
        "schema": "pmabench.model-rows/1",
        "model": model.name,
        "uncertainty": [{"inputs": list(names), "half": half} for names, half in groups],
        "columns": columns,
        "notes": notes,
    }

    keys = len(columns) - len(model.outputs) * (2 if groups else 1)
    show_columns(ui, data, keys=keys, as_csv=as_csv, below=() if ui.quiet else notes)


def _inputs(model: Model, table: Table, given: Mapping[str, Any]) -> tuple[dict[str, Any], list[Any]]:
    """Inputs by name [SI], single or of each row, and columns of all that the table has, as the model reads them."""
    from pmabench.cli.model_measured import columns_of
    from pmabench.files.table import numbers

    found, outputs, unused = columns_of(model, table, given)
    unused += [column.head.text for column, _ in outputs.values()]
    missing = [p.name for p in model.parameters if p.name not in found and p.name not in given]
    if missing:
        raise UsageError(f"{table.path} has no column of {', '.join(missing)}; add it, or give it with --set")
    quantities = {p.name: p.quantity for p in model.parameters}
    read, kept = numbers(table, [(column, quantities[name], unit) for name, (column, unit) in found.items()])
    if empty := sorted({*range(len(table.columns[0].cells))} - {*kept}):
        what = f"row {empty[0] + 1} of the table has an empty cell"
        raise UsageError(f"{table.path}: {what}; measure it, or leave the row out")
    shown = [column for column in table.columns if column.head.text in unused]
    others = [column_of(column.head.text, "", [cell.text for cell in column.cells]) for column in shown]
    others += [column_of(name, quantities[name], values.tolist()) for name, values in zip(found, read, strict=True)]
    return {**given, **dict(zip(found, read, strict=True))}, others


def _groups(model: Model, unsure: Sequence[tuple[str, str]]) -> Groups:
    """What `--uncertainty` says; UsageError with everything that is wrong."""
    known = {p.name: p for p in model.parameters if not p.choices}
    groups: Groups = []
    problems = Problems()
    for text, value in unsure:
        names = tuple(part.strip() for part in text.split(","))
        for name in names:
            if name not in known:
                problems.append(f'--uncertainty {name}: {model.name} has no input "{name}"{did_you_mean(name, known)}')
            elif any(name in others for others, _ in groups) or names.count(name) > 1:
                problems.append(f"--uncertainty {name}: given twice")
        with problems.of(f"--uncertainty {text}"):
            half = number_of(value, known[names[0]].quantity) if names[0] in known else 1.0
            groups.append((names, half))
            if not half > 0:
                problems.append(f"--uncertainty {text}: must be above zero")
            if len({known[name].quantity for name in names if name in known}) > 1:
                problems.append(f"--uncertainty {text}: one gauge does not measure different quantities")
    Problems(dict.fromkeys(problems)).refuse()
    return groups


def _evaluated(
    model: Model, inputs: dict[str, Any], groups: Groups, count: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Outputs of each row [SI] and their half widths: half of the change between both ends of each group's interval."""
    import numpy as np

    from pmabench.model.library import OutsideDomain

    def at(changed: Mapping[str, Any]) -> dict[str, Any]:
        found = model.evaluate({**inputs, **changed})
        return {name: np.broadcast_to(np.asarray(value, dtype=np.float64), (count,)) for name, value in found.items()}

    try:
        values = at({})
        squares = {name: np.zeros(count) for name in values}
        for names, half in groups:
            ends = [at({name: inputs[name] + sign * half for name in names}) for sign in (1.0, -1.0)]
            for name, square in squares.items():
                square += (0.5 * (ends[0][name] - ends[1][name])) ** 2
    except OutsideDomain as error:
        raise UsageError(f"{model.name}: {error}") from error
    return values, {name: np.sqrt(square) for name, square in squares.items()}
