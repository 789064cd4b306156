"""CSV tables with units in the head: what is read, and every cell that is wrong with its place."""

import pytest

from pmabench.base.errors import InvalidFile
from pmabench.files.table import Wanted, meaning, numbers, read_table, split_head, unit_scale


@pytest.fixture
def write(tmp_path):
    def make(text, encoding="utf-8"):
        path = tmp_path / "t.csv"
        path.write_bytes(text.encode(encoding))
        return path

    return make


def problems(path, *columns):
    def read():
        table = read_table(path)
        numbers(table, [(table.columns[i], quantity, table.columns[i].unit) for i, quantity in columns])

    with pytest.raises(InvalidFile) as caught:
        read()
    return [(p.line, p.column, p.message) for p in caught.value.problems]


@pytest.mark.parametrize(
    ("head", "name", "unit"),
    [
        ("pressure [kPa]", "pressure", "kPa"),
        ("P (bar)", "P", "bar"),
        ("contraction", "contraction", None),
        ("K [N/mm]", "K", "N/mm"),
    ],
)
def test_heads_have_their_unit_in_brackets(head, name, unit):
    assert split_head(head) == (name, unit)


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_cells_are_parted_by_what_the_head_is_parted_by(write, mark):
    text = f'# from a book,\n# page 3\npressure [bar]{mark}force [N]{mark}note\n1{mark}2.5e1{mark}"a{mark}b"\n'
    table = read_table(write(text))
    assert table.source == "from a book, page 3"
    assert [c.name for c in table.columns] == ["pressure", "force", "note"]
    assert table.columns[2].cells[0].text == f"a{mark}b"
    values, kept = numbers(table, [(table.columns[0], "pressure", "bar"), (table.columns[1], "force", "N")])
    assert [v.tolist() for v in values] == [[1e5], [25.0]]
    assert kept == [0]


def test_a_mark_of_the_byte_order_and_windows_lines_are_read(write):
    table = read_table(write("\ufeffpressure [kPa],force [N]\r\n100,5\r\n"))
    assert table.columns[0].name == "pressure"
    assert table.columns[1].cells[0].text == "5"


def test_rows_with_an_empty_cell_are_left_out(write):
    table = read_table(write("P [kPa],F [N]\n1,2\n3,\n5,6\n"))
    values, kept = numbers(table, [(table.columns[0], "pressure", "kPa"), (table.columns[1], "force", "N")])
    assert values[1].tolist() == [2, 6]
    assert kept == [0, 2]


def test_every_bad_cell_comes_at_once_with_its_place(write):
    path = write("pressure [kPa],  force [N]\n1,2\n3, x\nnan,4\n1e999,5\n7,1_000\n")
    found = problems(path, (0, "pressure"), (1, "force"))
    assert [(line, column) for line, column, _ in found] == [(3, 4), (4, 1), (5, 1), (6, 3)]
    assert [message.rpartition('" is ')[2] for _, _, message in found] == [
        "no number", "no number", "out of all range", "no number",
    ]  # fmt: skip


def test_a_decimal_comma_is_reported(write):
    assert "has a decimal comma" in problems(write("P [kPa];F [N]\n1,5;2\n"), (0, "pressure"))[0][2]
    assert "a decimal comma? write a point" in problems(write("P [kPa],F [N]\n1,5,2\n"))[0][2]


def test_rows_of_another_length_and_heads_that_come_twice_are_reported(write):
    found = problems(write("P [kPa],F [N],F [N]\n1,2\n1,2,3,4\n"))
    assert [line for line, _, _ in found] == [1, 2, 3]


@pytest.mark.parametrize(
    ("text", "reported"),
    [("", "holds no table"), ("# only words\n", "holds no table"), ("P [kPa]\n", "holds no table")],
)
def test_what_is_no_table_is_reported(write, text, reported):
    assert reported in problems(write(text))[0][2]


def test_other_encodings_and_missing_files_are_reported(write, tmp_path):
    assert "UTF-8" in problems(write("P [µbar],F\n1,2\n", "latin-1"))[0][2]
    assert "cannot be read" in problems(tmp_path / "none.csv")[0][2]
    assert "cannot be read" in problems(tmp_path)[0][2]


def test_a_unit_of_another_quantity_and_absolute_pressure_are_refused(write):
    assert "no unit of pressure" in problems(write("P [N],F [N]\n1,2\n"), (0, "pressure"))[0][2]
    assert "needs a unit of force" in problems(write("P [kPa],F\n1,2\n"), (1, "force"))[0][2]
    with pytest.raises(ValueError, match="gauge"):
        unit_scale("bar(abs)", "pressure")
    assert unit_scale(None, "ratio") == 1
    assert unit_scale("%", "ratio") == 0.01


def test_a_unit_behind_an_underscore_counts_where_the_whole_is_no_name(write):
    wanted = [Wanted(("pressure", "P"), "pressure"), Wanted(("k_s",), "count"), Wanted(("force", "F"), "force")]
    table = read_table(write("P_kPa,F_N,k_s,F_x\n1,2,3,4\n"))
    found = [meaning(column, wanted) for column in table.columns]
    assert [(item[0].names[0], item[1]) if item else None for item in found] == [
        ("pressure", "kPa"),
        ("force", "N"),
        ("k_s", None),
        None,
    ]
