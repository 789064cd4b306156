"""`pmabench model rows`: a model at each row of a table of measured inputs, with the uncertainty that they bring."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmabench.base.errors import UsageError, did_you_mean
from pmabench.cli.common import Ui, common
from pmabench.cli.model_inputs import column_of, named_model, number_of, pairs, read_inputs, show_columns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from pmabench.files.table import Table
    from pmabench.model.library import Model

    Array = NDArray[np.float64]

EXAMPLE = (
    "\b\npmabench model rows three-cylinder-volume diameters.csv \\\n"
    '    --set "thickness=1.5 mm" --uncertainty "thickness=0.05 mm" \\\n'
    '    --uncertainty "diameter_1, diameter_2, diameter_3=0.1 mm"'
)
Groups = list[tuple[tuple[str, ...], float]]
"""Inputs that are off together, and by how much [SI]: half widths of 95 % intervals."""


@click.command(epilog=EXAMPLE)
@click.argument("name")
@click.argument("table", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("--set", "settings", multiple=True, callback=pairs, metavar="NAME=VALUE", help="An input of all rows.")
@click.option(
    "--uncertainty", "unsure", multiple=True, callback=pairs, metavar="NAMES=VALUE",
    help="Half width of the 95 % interval of an input; of several, with commas, that one gauge measures.",
)  # fmt: skip
@click.option("--csv", "as_csv", is_flag=True, help="Comma-separated values in SI units on stdout.")
@common
def rows(
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

    found, unused = columns_of(model, table)
    twice = [name for name in found if name in given]
    if twice:
        raise UsageError(f"--set {twice[0]}: {table.path} has a column of it; give one or the other")
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
    problems: list[str] = []
    for text, value in unsure:
        names = tuple(part.strip() for part in text.split(","))
        for name in names:
            if name not in known:
                problems.append(f'--uncertainty {name}: {model.name} has no input "{name}"{did_you_mean(name, known)}')
            elif any(name in others for others, _ in groups) or names.count(name) > 1:
                problems.append(f"--uncertainty {name}: given twice")
        try:
            half = number_of(value, known[names[0]].quantity) if names[0] in known else 1.0
        except ValueError as error:
            problems.append(f"--uncertainty {text}: {error}")
            continue
        if not half > 0:
            problems.append(f"--uncertainty {text}: must be above zero")
        if len({known[name].quantity for name in names if name in known}) > 1:
            problems.append(f"--uncertainty {text}: one gauge does not measure different quantities")
        groups.append((names, half))
    if problems:
        raise UsageError("\n".join(dict.fromkeys(problems)))
    return groups


def _evaluated(
    model: Model, inputs: dict[str, Any], groups: Groups, count: int
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Outputs of each row [SI] and their half widths: half of the change between both ends of each group's interval."""
    import numpy as np

    from pmabench.model.library import OutsideDomain

    def at(changed: Mapping[str, Any]) -> dict[str, Array]:
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
