"""Tables too wide for a page: several that hold the same cells, none of them wide, none with an empty row."""

import pytest

from pmabench.plotting.wording import Frame
from pmabench.report.document.grids import MOST, grid, narrow
from pmabench.report.document.tables import Table


def cells(tables):
    """(method, pressure, head) -> cell, of all that is not empty."""
    found = {}
    for table in tables:
        for row in table.frame.rows:
            reported = {head: text for head, text in row.items() if head not in ("method", "P [kPa]") and text}
            assert reported, row
            for head, text in reported.items():
                place = row.get("method", ""), row["P [kPa]"], head
                assert place not in found
                found[place] = text
    return found


def frame(methods):
    """Each method has columns of its own, at two pressures."""
    rows = [
        {"method": method, "P [kPa]": str(P)} | {head: f"{method} {head} {P} ± 1" for head in heads}
        for method, heads in methods.items()
        for P in (100, 200)
    ]
    return Frame(rows)


@pytest.mark.parametrize(
    "methods",
    [
        {"a": ["K [N/mm]", "H [N]"], "b": ["W [J]", "eta [%]"], "c": ["w [mm]", "y [mm]", "z [mm]", "u [s]"]},
        {"a": [f"c{n} [N]" for n in range(20)]},
        {"a": [f"c{n} [N]" for n in range(9)], "b": ["d [N]"], "c": ["d [N]"]},
    ],
)
def test_every_cell_is_in_one_of_them(methods):
    whole = Table("Values", frame(methods))
    parts = narrow(whole)
    assert len(parts) > 1
    assert cells(parts) == cells([whole])
    for part in parts:
        assert len([c for c in part.frame.columns if c not in ("method", "P [kPa]")]) <= MOST
        assert part.caption.startswith("Values")


def test_columns_of_one_symbol_stay_together():
    heads = ["F [N] a", "F [N] b", "F [N] c", "K [N/mm] a", "K [N/mm] b", "K [N/mm] c", "B [N] a", "B [N] b"]
    parts = narrow(Table("", frame({"m": heads}).without("method")))
    assert [list(part.frame.columns[1:]) for part in parts] == [heads[:6], heads[6:]]


def test_no_single_column_is_left_over():
    parts = narrow(Table("", frame({"m": [f"c{n} [N]" for n in range(8)]}).without("method")))
    assert [len(part.frame.columns) - 1 for part in parts] == [6, 2]


def test_a_table_that_fits_is_left_alone():
    whole = Table("Values", frame({"a": ["K [N/mm]"], "b": ["H [N]"]}))
    assert narrow(whole) == [whole]


def test_plain_numbers_take_less_room():
    """Nine columns without intervals stand side by side, twelve do not."""
    rows = [{"P [kPa]": "100"} | {f"c{n} [s]": "1.5" for n in range(12)}]
    assert len(narrow(Table("", Frame(rows).without("c9 [s]").without("c10 [s]").without("c11 [s]")))) == 1
    assert len(narrow(Table("", Frame(rows)))) == 2


def test_what_is_said_of_many_rows_is_below_once():
    """The column of notes took half of the PDF's pages: its sentences, each once, are below, numbers in their place."""
    said = ["a; b", "", "b", "b; c"]
    made = grid(Frame([{"K": str(n), "note": note} for n, note in enumerate(said)]), notes="note")
    cells = [row[1].text for _, rows in made.groups for row in rows]
    assert [[made.notes[int(n) - 1] for n in cell.split(", ") if n] for cell in cells] == [
        ["a", "b"],
        [],
        ["b"],
        ["b", "c"],
    ]
    assert sorted(made.notes) == ["a", "b", "c"]
