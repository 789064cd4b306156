"""`pmabench model`: the library of models: what there is, what each says, and its values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from pmabench.cli.common import Ui, common

if TYPE_CHECKING:
    from pmabench.model.library import Model, Parameter

MOST_ROWS = 20_000


@click.group(name="model")
def command() -> None:
    """Models of muscles, regulators, loads and compositions: list, show and evaluate."""


@command.command(name="list")
@common
def list_models(ui: Ui) -> int | None:
    """Every model, by family."""
    from pmabench.model.library import MODELS

    models = list(MODELS.values())
    families = list(dict.fromkeys(model.family for model in models))
    data = {
        "schema": "pmabench.models/1",
        "models": [
            {"name": m.name, "family": m.family, "title": m.title, "source": m.source}
            for family in families
            for m in models
            if m.family == family
        ],
    }

    def human() -> None:
        from pmabench.report.terminal import print_grid

        rows = []
        for family in families:
            for index, model in enumerate(m for m in models if m.family == family):
                rows.append(["" if index else family, model.name, model.title])
        print_grid(
            ui.console(columns=120), ["family", "model", "what it gives"], rows, ("family", "model", "what it gives")
        )

    ui.result(data, human, (row["name"] for row in data["models"]))  # type: ignore[index]
    return None


@command.command(name="show")
@click.argument("name")
@common
def show_model(ui: Ui, name: str) -> int | None:
    """Equation, inputs with their domain, outputs, source and reference values of the model NAME."""
    model = _model(name)
    checks = []
    for reference in model.references:
        now = float(model.evaluate(reference.at)[reference.output])
        checks.append((reference, now, abs(now - reference.value) <= 1.001 * reference.rounding + 1e-12 * abs(now)))
    data = {
        "schema": "pmabench.model/1",
        "name": model.name,
        "family": model.family,
        "title": model.title,
        "equation": list(model.equation),
        "source": model.source,
        "inputs": [_input_facts(p) for p in model.parameters],
        "outputs": [
            {
                "name": o.name,
                "symbol": o.symbol,
                "quantity": o.quantity,
                "unit": _unit(o.quantity),
                "meaning": o.meaning,
            }
            for o in model.outputs
        ],
        "references": [
            {
                "output": r.output,
                "at": dict(r.at),
                "printed": r.printed,
                "printed_unit": r.unit,
                "value": r.value,
                "computed": now,
                "agrees": agrees,
                "source": r.source,
            }
            for r, now, agrees in checks
        ],
        "notes": list(model.notes),
    }

    def human() -> None:
        from pmabench.report.terminal import print_grid

        console = ui.console()
        click.echo(f"{model.name}: {model.title}\n")
        for line in model.equation:
            click.echo(f"  {line}")
        click.echo(f"\nSource: {model.source}.\n")
        rows = [
            [
                p.name,
                p.symbol,
                _shown(p, p.value),
                _domain(p),
                p.meaning + (f" ({p.origin})" if p.origin != "example" else ""),
            ]
            for p in model.parameters
        ]
        heads = ["input", "symbol", "reference", "domain", "meaning"]
        print_grid(console, heads, rows, ("input", "symbol", "reference", "domain", "meaning"))
        click.echo()
        rows = [[o.name, o.symbol, _display(o.quantity), o.meaning] for o in model.outputs]
        print_grid(console, ["output", "symbol", "unit", "meaning"], rows, ("output", "symbol", "unit", "meaning"))
        click.echo()
        parameters = {p.name: p for p in model.parameters}
        rows = [
            [
                r.output,
                ", ".join(f"{key} = {_shown(parameters[key], value)}" for key, value in r.at.items()) or "reference",
                f"{r.printed} {r.unit}".strip(),
                f"{now / r.scale:.7g} {r.unit}".strip(),
                "" if agrees else "DIFFERS",
                r.source,
            ]
            for r, now, agrees in checks
        ]
        heads = ["check", "at", "expected", "computed now", "", "expected from"]
        print_grid(console, heads, rows, ("check", "at", "", "expected from"))
        click.echo()
        for note in model.notes:
            for line in _wrapped(note, console.width):
                click.echo(line)

    ui.result(data, human)
    return None


def _pairs(_context: click.Context, _parameter: click.Parameter, values: tuple[str, ...]) -> list[tuple[str, str]]:
    pairs = []
    for value in values:
        name, equals, text = value.partition("=")
        if not equals or not name.strip():
            raise click.BadParameter(f'"{value}" is not name=value, for instance "pressure=300 kPa"')
        pairs.append((name.strip(), text.strip()))
    return pairs


@command.command(name="eval")
@click.argument("name")
@click.option("--set", "settings", multiple=True, callback=_pairs, metavar="NAME=VALUE", help="An input with its unit.")
@click.option(
    "--over",
    "axes",
    multiple=True,
    callback=_pairs,
    metavar="NAME=RANGE",
    help='A table over an input: "FIRST..LAST by STEP" or "A, B, C"; repeatable, the first outermost.',
)
@click.option("--csv", "as_csv", is_flag=True, help="Comma-separated values in SI units on stdout.")
@common
def eval_model(
    ui: Ui, name: str, settings: list[tuple[str, str]], axes: list[tuple[str, str]], *, as_csv: bool
) -> int | None:
    r"""Values of the model NAME; inputs that are not given are at their reference values.

    \b
    pmabench model eval tondu-lopez --set "pressure=300 kPa" --over "contraction=0 %..25 % by 5 %"
    """
    from pmabench.base.errors import UsageError

    if as_csv and ui.json:
        raise UsageError("--csv or --json, not both")
    model = _model(name)
    given, table = _read(model, settings, axes)
    inputs, columns = _grid(model, given, table)
    outputs = _evaluate(model, {**given, **columns})
    data = {
        "schema": "pmabench.model-eval/1",
        "model": model.name,
        "inputs": {
            p.name: {"value": inputs[p.name], "unit": _unit(p.quantity), "given": p.name in given}
            for p in model.parameters
            if p.name not in columns
        },
        "columns": [
            {"name": p.name, "quantity": p.quantity, "unit": _unit(p.quantity), "values": columns[p.name]}
            for p in model.parameters
            if p.name in columns
        ]
        + [
            {"name": o.name, "quantity": o.quantity, "unit": _unit(o.quantity), "values": outputs[o.name]}
            for o in model.outputs
        ],
    }

    def human() -> None:
        if as_csv:
            _print_csv(data["columns"])  # type: ignore[arg-type]
        else:
            _print_values(ui, model, given, inputs, columns, outputs)

    ui.result(data, human)
    return None


# -- reading -----------------------------------------------------------------------------------------------------


def _model(name: str) -> Model:
    from pmabench.base.errors import UsageError, did_you_mean
    from pmabench.model.library import MODELS

    if name not in MODELS:
        raise UsageError(f'no model "{name}"{did_you_mean(name, MODELS)}')
    return MODELS[name]


def _read(
    model: Model, settings: list[tuple[str, str]], axes: list[tuple[str, str]]
) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """Values given and the axes of the table; UsageError with everything that is wrong."""
    from pmabench.base.errors import UsageError, did_you_mean

    parameters = {p.name: p for p in model.parameters}
    given: dict[str, Any] = {}
    table: dict[str, list[Any]] = {}
    problems: list[str] = []
    for option, pairs in (("--set", settings), ("--over", axes)):
        for key, text in pairs:
            if key not in parameters:
                problems.append(f'{option} {key}: {model.name} has no input "{key}"{did_you_mean(key, parameters)}')
            elif key in given or key in table:
                problems.append(f"{option} {key}: given twice")
            else:
                try:
                    if option == "--set":
                        given[key] = _value(parameters[key], text)
                    else:
                        table[key] = _axis(parameters[key], text)
                except ValueError as error:
                    problems.append(f"{option} {key}: {error}")
    rows = math.prod(len(axis) for axis in table.values())
    if rows > MOST_ROWS:
        problems.append(f"--over: {rows} rows; at most {MOST_ROWS} are made")
    if problems:
        raise UsageError("\n".join(problems))
    return given, table


def _value(parameter: Parameter, text: str) -> float | str:
    """One value [SI], or the name of a choice; ValueError that says what is expected."""
    from pmabench.base.errors import did_you_mean
    from pmabench.files.quantity import parse_quantity

    if parameter.choices:
        if text not in parameter.choices:
            raise ValueError(
                f'"{text}" is none of {", ".join(parameter.choices)}{did_you_mean(text, parameter.choices)}'
            )
        return text
    if parameter.quantity == "count":
        try:
            return float(text)
        except ValueError:
            raise ValueError(f'"{text}" is no number; a pure number is expected, for instance "1.2"') from None
    return parse_quantity(text, parameter.quantity)


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


def _grid(
    model: Model, given: dict[str, Any], table: dict[str, list[Any]]
) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """Every single input, and the columns of the table: all combinations of its axes."""
    from itertools import product

    inputs = {p.name: given.get(p.name, p.value) for p in model.parameters if p.name not in table}
    rows = list(product(*table.values()))
    return inputs, {name: [row[index] for row in rows] for index, name in enumerate(table)}


def _evaluate(model: Model, values: dict[str, Any]) -> dict[str, list[float | None]]:
    """The outputs row by row [SI]; UsageError with the reasons where the model does not hold."""
    import numpy as np

    from pmabench.base.errors import UsageError
    from pmabench.model.library import OutsideDomain

    parameters = {p.name: p for p in model.parameters}
    names = [name for name in values if parameters[name].choices and isinstance(values[name], list)]
    count = max((len(value) for value in values.values() if isinstance(value, list)), default=1)
    try:
        if not names:
            found = [model.evaluate(values)]
        else:
            found = [
                model.evaluate({key: v[i] if isinstance(v, list) else v for key, v in values.items()})
                for i in range(count)
            ]
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


# -- words -------------------------------------------------------------------------------------------------------


def _unit(quantity: str) -> str:
    from pmabench.base.quantities import QUANTITIES

    return QUANTITIES[quantity].unit if quantity else ""


def _display(quantity: str) -> str:
    from pmabench.base.quantities import QUANTITIES

    return QUANTITIES[quantity].shown_in if quantity else ""


def _shown(parameter: Parameter, value: object, digits: int = 6) -> str:
    from pmabench.base.quantities import show

    return value if isinstance(value, str) else show(float(value), parameter.quantity, digits)  # type: ignore[arg-type]


def _domain(parameter: Parameter) -> str:
    """The range in words."""
    if parameter.choices:
        return " or ".join(parameter.choices)
    low, high = (_shown(parameter, value) for value in (parameter.low, parameter.high))
    if not math.isfinite(parameter.low):
        return "any" if not math.isfinite(parameter.high) else f"up to {high}"
    start = f"above {low}" if parameter.above else low
    if not math.isfinite(parameter.high):
        return start if parameter.above else f"from {low}"
    return f"{start} to {high}"


def _sentence(parameter: Parameter | None, refusal: Any) -> str:
    if parameter is None or math.isnan(refusal.low):
        return f"{refusal.name}: {refusal.reason}"
    reason = f": {refusal.reason}" if refusal.reason else ""
    return f"{refusal.name} = {_shown(parameter, refusal.value)} is outside its domain, {_domain(parameter)}{reason}"


def _input_facts(parameter: Parameter) -> dict[str, Any]:
    ends = (parameter.low, parameter.high)
    return {
        "name": parameter.name,
        "symbol": parameter.symbol,
        "quantity": parameter.quantity,
        "unit": _unit(parameter.quantity),
        "reference": parameter.value,
        "origin": parameter.origin,
        "domain": [end if math.isfinite(end) else None for end in ends],
        "choices": list(parameter.choices),
        "reason": parameter.reason,
        "meaning": parameter.meaning,
    }


def _wrapped(text: str, width: int) -> list[str]:
    from textwrap import wrap

    return wrap(text, width, initial_indent="- ", subsequent_indent="  ")


# -- printing ----------------------------------------------------------------------------------------------------


def _print_values(
    ui: Ui,
    model: Model,
    given: dict[str, Any],
    inputs: dict[str, Any],
    columns: dict[str, list[Any]],
    outputs: dict[str, list[float | None]],
) -> None:
    from pmabench.report.terminal import print_grid

    parameters = {p.name: p for p in model.parameters}
    console = ui.console()
    for own, word in ((True, "given:"), (False, "at their reference values:")):
        shown = [f"{key} {_shown(parameters[key], value)}" for key, value in inputs.items() if (key in given) == own]
        if shown and not ui.quiet:
            click.echo(f"{word} {', '.join(shown)}")
    if not ui.quiet:
        click.echo()
    if not columns:
        rows = [[o.name, o.symbol, _cell(o.quantity, outputs[o.name][0]), _display(o.quantity)] for o in model.outputs]
        print_grid(console, ["output", "symbol", "value", "unit"], rows, ("output", "symbol", "unit"))
        return
    heads, cells = [], []
    for key, values in columns.items():
        heads.append(f"{key} {_display(parameters[key].quantity)}".strip())
        cells.append([v if isinstance(v, str) else _cell(parameters[key].quantity, v) for v in values])
    for output in model.outputs:
        heads.append(f"{output.name} {_display(output.quantity)}".strip())
        cells.append([_cell(output.quantity, value) for value in outputs[output.name]])
    texts = [head for head, column in zip(heads, cells, strict=True) if column and not column[0][-1:].isdigit()]
    print_grid(console, heads, [list(row) for row in zip(*cells, strict=True)], texts, len(columns))


def _cell(quantity: str, value: float | None) -> str:
    from pmabench.base.quantities import QUANTITIES

    return "" if value is None else f"{value / QUANTITIES[quantity].scale:.6g}"


def _print_csv(columns: Sequence[dict[str, Any]]) -> None:
    import csv
    import sys

    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow([f"{c['name']} [{c['unit']}]" if c["unit"] else c["name"] for c in columns])
    for row in zip(*(c["values"] for c in columns), strict=True):
        writer.writerow(["" if value is None else value if isinstance(value, str) else repr(value) for value in row])
