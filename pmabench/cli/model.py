"""`pmabench model`: the library of models: what there is, what each says, and its values."""

from __future__ import annotations

import math
from textwrap import fill
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError
from pmabench.cli.cascade import command as cascade
from pmabench.cli.common import Ui, common, fields
from pmabench.cli.model_fit import fit
from pmabench.cli.model_inputs import (
    cell,
    column_of,
    display_unit,
    grid,
    named_model,
    pairs,
    print_csv,
    print_table,
    read_inputs,
    shown,
    si_unit,
)
from pmabench.cli.model_rows import rows
from pmabench.cli.model_simulate import simulate
from pmabench.report.terminal import print_grid, print_texts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pmabench.model.library import Model, Parameter
    from pmabench.model.library.description import Reference

    Check = tuple[Reference, float, bool]
    """A reference value, what is computed now, and whether they agree."""


EXAMPLE = '\b\npmabench model eval tondu-lopez --set "pressure=300 kPa" \\\n    --over "contraction=0 %..25 % by 5 %"'


@click.group(name="model")
def command() -> None:
    """Models of muscles, regulators, loads and compositions: list, show, evaluate, simulate, fit."""


command.add_command(simulate)
command.add_command(fit)
command.add_command(rows)
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
            _print_inputs(ui.console().width, model, given, inputs)
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


def _print_inputs(width: int, model: Model, given: dict[str, Any], inputs: dict[str, Any]) -> None:
    parameters = {p.name: p for p in model.parameters}
    for own, word in ((True, "given:"), (False, "at their reference values:")):
        settings = [f"{key} {shown(parameters[key], value)}" for key, value in inputs.items() if (key in given) == own]
        if settings:
            click.echo(fill(f"{word} {', '.join(settings)}", width, subsequent_indent="  ", break_on_hyphens=False))
    click.echo()


def _print_outputs(ui: Ui, model: Model, outputs: dict[str, list[float | None]]) -> None:
    heads = ["output", "symbol", "value", "unit", "meaning"]
    rows = [
        [o.name, o.symbol, cell(o.quantity, outputs[o.name][0]), display_unit(o.quantity), o.meaning]
        for o in model.outputs
    ]
    print_grid(ui.console(), heads, rows, ("output", "symbol", "unit", "meaning"))
