"""`pmabench model fit`: fits inputs of a model to measured rows, with intervals, and says what cannot be found."""

from __future__ import annotations

import csv
import sys
from collections.abc import Mapping, Sequence
from math import floor, log10
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.base.quantities import QUANTITIES
from pmabench.cli.common import Problems, Ui, common, fields
from pmabench.cli.model_inputs import (
    display_unit,
    named_model,
    number_of,
    pairs,
    print_settings,
    read_inputs,
    shown,
    si_unit,
)
from pmabench.cli.names import FILE, PATH
from pmabench.report.terminal import print_grid

if TYPE_CHECKING:
    from pmabench.analysis.model_fit import Follows, ModelFit, Unknown
    from pmabench.cli.model_measured import Measured
    from pmabench.model.library import Model, Parameter
    from pmabench.model.library.description import Output

EXAMPLE = (
    "\b\n"
    "pmabench model fit tondu-lopez rows.csv --set k=1 --plot fit.svg\n"
    "with a head like: pressure [kPa], contraction [%], force [N]"
)
NOT_CONVERGED = 6
MOST_CORRELATED = 8
"""Unknowns up to which the correlations are printed as a table."""


@click.command(name="fit", epilog=EXAMPLE)
@click.argument("name", metavar="MODEL")
@click.argument("table", type=PATH, metavar="FILE.csv|ANALYSIS")
@click.option("--free", help="Inputs to fit, with commas; without it those that the model names as fitted.")
@click.option("--set", "settings", multiple=True, callback=pairs, metavar="NAME=VALUE", help="An input that is known.")
@click.option("--start", "starts", multiple=True, callback=pairs, metavar="NAME=VALUE", help="Where to begin.")
@click.option("--output", metavar="NAME", help="What was measured, where the table has several outputs.")
@click.option(
    "--within", multiple=True, callback=pairs, metavar="NAME=RANGE", help='Rows in it: "FIRST..LAST" with units.'
)
@click.option("--csv", "as_csv", is_flag=True, help="The fitted values comma-separated, SI, on stdout.")
@click.option("--plot", type=FILE, metavar="FILE.svg", help="Draw data and fit.")
@common
def fit(
    ui: Ui,
    name: str,
    table: Path,
    free: str | None,
    settings: list[tuple[str, str]],
    starts: list[tuple[str, str]],
    within: list[tuple[str, str]],
    *,
    as_csv: bool,
    plot: Path | None,
    output: str | None,
) -> int | None:
    """Fit inputs of MODEL to the rows of a table with units in its head.

    Columns are inputs and one output of the model, by name or symbol; other inputs are given with --set or stay at
    their reference values. Exit code 6 where the fit did not converge.
    """
    from pmabench.cli.model_measured import read_measured

    if plot is not None and plot.suffix.lower() != ".svg":
        raise UsageError(f"--plot {plot}: an SVG is drawn; give a name that ends in .svg")
    model = named_model(name)
    given, _ = read_inputs(model, settings, [])
    begin, _ = read_inputs(model, starts, [], option="--start")
    measured = read_measured(model, table, ranges=_ranges(model, within), given=given, output=output)
    found = _fit(model, measured, given, begin, free)
    if plot is not None:
        from pmabench.report.fit_figure import write_fit

        write_fit(found, plot, table.name, measured.source)
    data = _data(found, measured, table, given)

    def human() -> None:
        if as_csv:
            _print_csv(data)
        else:
            _print(ui, found, measured, table, given)
            if plot is not None:
                click.echo(str(plot))

    for note in measured.notes:
        ui.note(note)
    ui.result(data, human, [f"{u['name']} {u['value']!r} {u['unit']}" for u in data["parameters"]])
    return None if found.converged else NOT_CONVERGED


def _ranges(model: Model, within: list[tuple[str, str]]) -> dict[str, tuple[float, float]]:
    """Ends of the inputs or outputs [SI] between which rows count."""
    quantities = {o.name: o.quantity for o in model.outputs}
    quantities |= {p.name: p.quantity for p in model.parameters if not p.choices}
    found: dict[str, tuple[float, float]] = {}
    problems = Problems()
    for name, text in within:
        with problems.of(f"--within {name}"):
            first, dots, last = text.partition("..")
            if name not in quantities:
                raise ValueError(f'{model.name} has no input or output "{name}"{did_you_mean(name, quantities)}')
            if not dots:
                raise ValueError(f'"{text}" is no range; write "FIRST..LAST" with units')
            low, high = sorted(number_of(part.strip(), quantities[name]) for part in (first, last))
            found[name] = low, high
    problems.refuse()
    return found


def _fit(
    model: Model, measured: Measured, given: Mapping[str, Any], begin: Mapping[str, Any], free: str | None
) -> ModelFit:
    """The fit, or UsageError with what makes it impossible."""
    from pmabench.analysis.model_fit import fit_model
    from pmabench.model.library import OutsideDomain

    fixed = {p.name: given.get(p.name, p.value) for p in model.parameters if p.name not in measured.columns}
    for name, values in measured.columns.items():
        for end, value in (("low", values.min()), ("high", values.max())):
            if f"{name}_{end}" in fixed and f"{name}_{end}" not in given:
                fixed[f"{name}_{end}"] = float(value)
    unknown = _unknown(model, measured, given, fixed, begin, free)
    try:
        known = {name: value for name, value in fixed.items() if name not in unknown}
        start = {name: float(value) for name, value in begin.items()}
        values, halves = measured.values, measured.halves
        return fit_model(model, measured.output, measured.columns, known, values, unknown, start=start, halves=halves)
    except (ValueError, OutsideDomain) as error:
        raise UsageError(f"{model.name}: {error}") from error


def _unknown(
    model: Model,
    measured: Measured,
    given: Mapping[str, Any],
    fixed: Mapping[str, Any],
    begin: Mapping[str, Any],
    free: str | None,
) -> list[str]:
    """Inputs that are fitted: those of `--free`, or those that the model names and that change the output."""
    from pmabench.analysis.model_problem import acting

    able = [p.name for p in model.parameters if not p.choices and p.name not in measured.columns]
    if free is None:
        asked = [name for name in model.fitted if name in able and name not in given]
        unknown = acting(model, measured.output, asked, {**fixed, **measured.columns}, begin)
        known = {p.name: p for p in model.parameters}
        idle = [f"{name} changes nothing at these rows: left at {shown(known[name], fixed[name])}"
                for name in asked if name not in unknown]  # fmt: skip
        measured.notes.extend(idle)
        if not unknown:
            others = ", ".join(name for name in able if name not in given)
            raise UsageError(f"nothing to fit: name inputs with --free, of {others}")
    else:
        unknown = list(dict.fromkeys(name.strip() for name in free.split(",") if name.strip()))
        problems = Problems([] if unknown else ["--free names nothing"])
        for name in unknown:
            if name in measured.columns:
                problems.append(f"--free {name}: the table has a column of it")
            elif name in given:
                problems.append(f"--free {name}: it is given with --set; one or the other")
            elif name not in able:
                problems.append(f"--free {name}: {model.name} has no such input{did_you_mean(name, able)}")
        problems.refuse()
    wrong = [name for name in begin if name not in unknown]
    if wrong:
        raise UsageError(f"--start {wrong[0]}: it is not fitted{did_you_mean(wrong[0], unknown)}")
    return unknown


def _data(found: ModelFit, measured: Measured, table: Path, given: Mapping[str, Any]) -> dict[str, Any]:
    """The documented JSON object."""
    known = {p.name: p for p in found.model.parameters}
    outputs = {o.name: o for o in found.model.outputs}
    return {
        "schema": "pmabench.model-fit/1",
        "model": found.model.name,
        "file": str(table),
        "output": {"name": found.output, "unit": si_unit(outputs[found.output].quantity)},
        "parameters": [
            fields(u, "name", "value", "standard_error", "ci95", "start", "note")
            | fields(known[u.name], "symbol", "quantity")
            | {"unit": si_unit(known[u.name].quantity)}
            for u in found.unknowns
        ],
        "follows": [
            fields(f, "name", "value", "standard_error", "ci95") | {"unit": si_unit(outputs[f.name].quantity)}
            for f in found.follows
        ],
        "inputs": {
            name: {"value": value, "unit": si_unit(known[name].quantity), "given": name in given}
            for name, value in found.fixed.items()
            if name in given or name not in found.idle
        },
        "correlation": [[None if value != value else float(value) for value in row] for row in found.correlation],
        **fields(found, "residual_rms", "starts", "converged"),
        "largest_residual": float(abs(found.computed - found.measured).max()),
        "degrees_of_freedom": found.freedom,
        "rows": len(found.measured),
        "rows_left_out": measured.left_out,
        "domain": {
            column: {"lowest": float(v.min()), "highest": float(v.max()), "unit": si_unit(known[column].quantity)}
            for column, v in found.columns.items()
        },
        "intervals": found.method,
        "starts_agreeing": found.agreeing,
        "notes": list(measured.notes),
        "findings": [fields(f, "level", "text") for f in found.findings],
    }


def _print_csv(data: Mapping[str, Any]) -> None:
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(["name", "value", "unit", "standard_error", "low95", "high95"])
    for u in data["parameters"]:
        low, high = u["ci95"] or (None, None)
        interval = ["" if value is None else repr(value) for value in (u["standard_error"], low, high)]
        writer.writerow([u["name"], repr(u["value"]), u["unit"], *interval])


def _print(ui: Ui, found: ModelFit, measured: Measured, table: Path, given: Mapping[str, Any]) -> None:
    known = {p.name: p for p in found.model.parameters}
    outputs = {o.name: o for o in found.model.outputs}
    console = ui.console()
    ranges = ", ".join(
        f"{name} {shown(known[name], float(v.min()))} to {shown(known[name], float(v.max()))}"
        for name, v in found.columns.items()
    )
    left = f" ({measured.left_out} without a value or outside left out)" if measured.left_out else ""
    click.echo(f"{found.model.name}, {found.output}, fitted to {len(found.measured)} rows of {table}{left}")
    click.echo(f"holds for {ranges}\n")
    _print_values(ui, found, known, outputs)
    quantity = outputs[found.output].quantity
    scale, unit = QUANTITIES[quantity].scale, display_unit(quantity)
    largest = float(abs(found.computed - found.measured).max()) / scale
    residual = f"\nresidual rms {found.residual_rms / scale:.3g}, largest {largest:.3g} {unit}".rstrip()
    freedom = f"{found.freedom} degrees of freedom; {found.agreeing} of {found.starts} starts ended here"
    click.echo(f"{residual}; {freedom}")
    others = "not fitted, at reference values or ends of the data"
    print_settings(console.width, found.model, found.fixed, given, others, found.idle)
    if 1 < len(found.unknowns) <= MOST_CORRELATED:
        click.echo()
        names = [u.name for u in found.unknowns]
        lower = [["" if value != value else f"{value:+.4f}" for value in row] for row in found.correlation]
        rows = [[name, *lower[i][: i + 1], *[""] * (len(names) - i - 1)] for i, name in enumerate(names)]
        print_grid(console, ["correlation", *names], rows, ("correlation",))
    for finding in found.findings:
        click.echo(fill(f"{finding.level}: {finding.text}", console.width, subsequent_indent="  "))


def _print_values(ui: Ui, found: ModelFit, known: Mapping[str, Parameter], outputs: Mapping[str, Output]) -> None:
    """What was fitted, and what follows from it, with intervals."""
    rows: list[list[str]] = []
    fitted: list[tuple[Unknown | Follows, Parameter | Output]] = [(u, known[u.name]) for u in found.unknowns]
    for one, item in [*fitted, *((f, outputs[f.name]) for f in found.follows)]:
        name, lacking = (f"({one.name})", "") if one in found.follows else (one.name, "not identifiable")
        scale = QUANTITIES[item.quantity].scale
        cells = [f"{one.value / scale:.6g}", lacking, ""]
        if one.standard_error is not None:
            ends = [None if end is None else end / scale for end in one.ci95 or ()]
            cells = _interval_cells(one.value / scale, one.standard_error / scale, ends)
        rows.append([name, item.symbol, *cells, display_unit(item.quantity)])
    heads = ["fitted", "symbol", "value", "standard error", "95 % interval", "unit"]
    print_grid(ui.console(), heads, rows, ("fitted", "symbol", "unit"))
    if found.follows:
        click.echo("in brackets: follows from the fitted")


def _interval_cells(value: float, error: float, ends: Sequence[float | None]) -> list[str]:
    """Value, standard error and interval with the digits that the interval leaves."""
    smallest = error if error > 1e-9 * abs(value) else 1e-9 * (abs(value) or 1.0)
    decimals = min(12, max(0, 1 - floor(log10(smallest))))
    spelled = ["open" if end is None else f"{end:.{decimals}f}" for end in ends]
    return [f"{value:.{decimals}f}", f"{error:.2g}", " to ".join(spelled)]
