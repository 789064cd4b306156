"""Tables on terminals of any width: every number stays in one piece, every text is there, nothing is too wide."""

from io import StringIO

from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from pmabench.report.terminal import print_grid

number = st.one_of(
    st.builds(lambda a, b: f"{a:.4g} ± {b:.2g}", st.floats(-1e6, 1e6), st.floats(1e-6, 1e3)),
    st.builds(lambda a: f"{a:.6g} kPa/(mm.s)", st.floats(1e-9, 1e9)),
    st.sampled_from(["", "not identifiable", "3/4"]),
)
text = st.text("abc de-/_", max_size=60).map(lambda t: " ".join(t.split()))
heads = ["rule", "P [kPa]", "F_ce [N]", "B_r [N·s/mm]", "phase margin", "note"]


def printed(heads, rows, texts, width, keys=1):
    console = Console(file=StringIO(), width=width, highlight=False, markup=False)
    print_grid(console, heads, rows, texts, keys)
    return console.file.getvalue()


@given(st.lists(st.tuples(text, number, number, number, number, text), min_size=1, max_size=4), st.integers(44, 140))
def test_numbers_are_never_cut_and_no_line_is_wider_than_the_terminal(rows, width):
    out = printed(heads, rows, {"rule", "note"}, width)
    assert all(len(line) <= width for line in out.splitlines())
    together = "".join(out.split())
    for row in rows:
        for cell in row[1:5]:
            assert any(cell in line for line in out.splitlines()) or not any(sign.isdigit() for sign in cell)
        for cell in (row[0], row[5]):
            assert all(sign in together for sign in cell if sign != " ")


def test_a_table_that_fits_is_printed_as_it_is():
    out = printed(["a b", "n [N]"], [["x y", "1.0 ± 0.1"], ["z", "22.0 ± 0.1"]], {"a b"}, 80)
    assert out == "a b       n [N]\nx y   1.0 ± 0.1\nz    22.0 ± 0.1\n"


def test_a_table_too_wide_is_parted_and_each_part_has_the_key():
    out = printed(["P [kPa]", "F_ce [N]", "K [N/mm]"], [["300", "275.0 ± 0.5", "6.770 ± 0.011"]], (), 25)
    assert out == "P [kPa]     F_ce [N]\n    300  275.0 ± 0.5\n\nP [kPa]       K [N/mm]\n    300  6.770 ± 0.011\n"


def test_heads_and_texts_are_wrapped_before_a_table_is_parted():
    out = printed(["rule", "F_ce [N]"], [["Ziegler-Nichols PID", "275.0 ± 0.5"]], {"rule"}, 28)
    assert out == "rule                F_ce [N]\nZiegler-Nichols  275.0 ± 0.5\nPID\n"


def test_a_number_wider_than_the_terminal_is_left_whole():
    assert "1234567890123456789012345 kPa" in printed(["n"], [["1234567890123456789012345 kPa"]], (), 10)
