"""Text is read with the layout that is given; whatever does not fit it is refused at its line."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmabench.base.errors import InvalidFile
from pmabench.store.formats.text import TextLayout
from pmabench.store.formats.text_reader import TextReader
from pmabench.store.importers.table import read_table

PLAIN = {"delimiter": "comma", "header": "none", "names": ["t", "p", "f"]}
NAMED = {"delimiter": "comma", "header": "first line"}
GOOD = b"0,1.5,-3\n0.1,2.5,4e2\n0.2,3.5,+5\n"


def parse(path, content, layout, wanted, piece=4_000_000, **more):
    """All rows of a file that is fed piece by piece, with what the reader says of its end."""
    reader = TextReader(path, layout, wanted, **more)
    rows = reader.joined(
        [*(reader.feed(content[at : at + piece]) for at in range(0, len(content), piece)), reader.end()]
    )
    reported = {name: getattr(reader, name) for name in ("cut_end", "cut_row", "head")}
    return SimpleNamespace(**vars(rows), **reported)


def table(tmp_path, content, layout=PLAIN, wanted=("t", "p", "f"), **more):
    return parse("old.csv", content, TextLayout(**layout), wanted, **more)


def refused(tmp_path, content, layout=PLAIN, wanted=("t", "p", "f"), **more):
    with pytest.raises(InvalidFile) as caught:
        table(tmp_path, content, layout, wanted, **more)
    assert caught.value.exit_code == 3
    return caught.value.problems


def test_numbers_as_they_stand(tmp_path):
    read = table(tmp_path, GOOD)
    assert read.columns["f"].tolist() == [-3, 400, 5]
    assert read.columns["p"].dtype == np.float64
    assert read.lines.tolist() == [1, 2, 3]
    assert not read.cut_end
    assert table(tmp_path, GOOD[:-1]).cut_end


def test_blank_lines_comments_and_skipped_lines(tmp_path):
    content = b"rubbish, of, any, kind\n# told\nt,p,f\n\n0,1,2\n\n# more\n1,2,3\n"
    layout = {**NAMED, "blank_lines": "skip", "comment": "#", "skip_lines": 1}
    read = table(tmp_path, content, layout)
    assert read.columns["t"].tolist() == [0, 1]
    assert read.lines.tolist() == [5, 8]
    (problem,) = refused(tmp_path, content, {**layout, "blank_lines": "refuse"})
    assert problem.line == 4
    assert "blank" in problem.message


def test_decimal_comma_tabs_blanks_and_line_ends(tmp_path):
    comma = {**PLAIN, "delimiter": "semicolon", "decimal": "comma"}
    assert table(tmp_path, b"0;1,5;2\r\n1;2,5;3\r\n", comma).columns["p"].tolist() == [1.5, 2.5]
    blank = {**PLAIN, "delimiter": "blank"}
    assert table(tmp_path, b"  0  1.5\t2\n1 2.5 3\n", blank).columns["p"].tolist() == [1.5, 2.5]
    assert table(tmp_path, b"0\t1.5\t2\n", {**PLAIN, "delimiter": "tab"}).columns["f"].tolist() == [2]
    assert table(tmp_path, "\ufeff0,1.5,2\n".encode()).columns["t"].tolist() == [0]
    assert table(tmp_path, "0,1.5,2\n".encode("utf-16"), {**PLAIN, "encoding": "utf-16"}).columns["p"].tolist() == [1.5]
    (problem,) = refused(tmp_path, b"0;1.5;2\n", comma)
    assert '"1.5" is no number' in problem.message


def test_quotation_marks_only_where_they_are_given(tmp_path):
    quoted = {**PLAIN, "quoted": True}
    assert table(tmp_path, b'"0","1.5","2"\n1,"2.5",3\n', quoted).columns["p"].tolist() == [1.5, 2.5]
    comma = {**quoted, "decimal": "comma"}
    assert table(tmp_path, b'"0","1,5","2"\n', comma).columns["p"].tolist() == [1.5]
    assert "is no number" in refused(tmp_path, b'"0","1.5","2"\n')[0].message
    for content, reported in ((b'0,"1.5,2\n', "within quotation marks"), (b'0,"1.5"x,2\n', "within quotation marks"),
                          (b'0,"1\t5",2\n', "a tab within a field"), (b'0,"two",2\n', '"two" is no number')):  # fmt: skip
        (problem,) = refused(tmp_path, content, quoted)
        assert (problem.line, reported in problem.message) == (1, True)


def test_missing_values_only_where_they_are_given(tmp_path):
    read = table(tmp_path, b"0,n/a,2\n1,3,-\n", {**PLAIN, "missing": ["n/a", "-"]})
    assert np.isnan(read.columns["p"][0])
    assert np.isnan(read.columns["f"][1])
    assert "n/a" in refused(tmp_path, b"0,n/a,2\n")[0].message


def test_optional_and_ignored_columns(tmp_path):
    four = {**PLAIN, "names": ["t", "p", "f", "phase"]}
    assert "phase" not in table(tmp_path, GOOD, four, optional=["phase"]).columns
    read = table(tmp_path, b"0,1,2,1\n", four, optional=["phase"])
    assert read.columns["phase"].tolist() == [1]
    read = table(tmp_path, b"t,who,p\n0,me,2\n", NAMED, ["t", "p"], ignored=["who"])
    assert set(read.columns) == {"t", "p"}


@pytest.mark.parametrize(
    ("content", "line", "message"),
    [
        (b"", 0, "is empty"),
        (b"\n \n", 0, "is empty"),
        (b"0,1,2\n\x00\x01\x02\n", 0, "is binary"),
        (b"0,1,2\n\xff\xfe\xfd\n", 0, "not text in utf-8"),
        (b"0,1,2\n0.1,2\n", 2, "has 2 columns, 3 are expected"),
        (b"0,1,2\n0.1,2\n0.2,3,4\n", 2, "has 2 columns, 3 are expected"),
        (b"0;1;2\n1;2;3\n", 1, "is not delimited by comma"),
        (b"0,1,2\n0.1,two,3\n", 2, '"two" is no number, in column "p"'),
        (b"0,1,2\n0.1,,3\n", 2, '"" is no number'),
        (b"0,1,2\n0.1,1.2.3,3\n", 2, '"1.2.3" is no number'),
        (b"0,1,2\n0.1,nan,3\n", 2, '"nan" is no number'),
        (b"0,1,2\n0.1,inf,3\n", 2, '"inf" is no number'),
        (b"0,1,2\n0.1,1e999,3\n", 2, "no finite number"),
        (b"0,1,2\n0.1,1_0,3\n", 2, '"1_0" is no number'),
        (b"0,1,2\n0.1,True,3\n", 2, '"True" is no number'),
        (b"0,1,2\n0.1,0x10,3\n", 2, '"0x10" is no number'),
    ],
)
def test_what_does_not_fit_is_refused_at_its_line(tmp_path, content, line, message):
    problem = refused(tmp_path, content)[0]
    assert problem.line == line
    assert message in problem.message


def test_a_late_fault_is_found_at_its_line_too(tmp_path):
    lines = [b"%d,1,2" % k for k in range(3000)]
    lines[2500] = b"2500,1-1,2"
    (problem,) = refused(tmp_path, b"\n".join(lines) + b"\n")
    assert problem.line == 2501


def test_columns_are_named_by_the_map(tmp_path):
    problems = refused(tmp_path, b"T_(ms),p,f\n0,1,2\n", NAMED, ["T_(s)", "p", "f"])
    reported = [problem.message for problem in problems]
    assert any('has no column "T_(s)"; did you mean "T_(ms)"?' in text for text in reported)
    assert any('does not say what column "T_(ms)" is' in text for text in reported)
    assert "holds a header and no data" in refused(tmp_path, b"t,p,f\n", NAMED)[0].message
    assert "same name" in refused(tmp_path, b"t,t,f\n0,1,2\n", NAMED)[0].message


def test_what_is_no_file_is_refused(tmp_path):
    for path in (tmp_path, tmp_path / "nowhere.csv"):
        with pytest.raises(InvalidFile):
            read_table(path, TextLayout(**PLAIN), ["t"])


def test_more_rows_than_one_piece(tmp_path):
    read = table(tmp_path, b"".join(b"%d,1,2\n" % k for k in range(100)), piece=7)
    assert read.columns["t"].tolist() == list(range(100))


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.data())
def test_mutated_files_are_read_or_refused(data):
    content = bytearray(b"t,p,f\n\n" + b"".join(b"%d,%d.5,-3e1\n" % (k, k) for k in range(20)))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        until = at + data.draw(st.integers(0, 20))
        content[at:until] = data.draw(
            st.one_of(st.binary(max_size=6), st.sampled_from([b",", b"\n", b"\t", b'"', b"\r"]))
        )
    try:
        read = parse("mutated.csv", bytes(content), TextLayout(**NAMED, blank_lines="skip"), ["t", "p", "f"])
    except InvalidFile as refused:
        assert refused.problems
    else:
        assert all(np.isfinite(column).all() for column in read.columns.values())


def test_rows_without_a_time_are_a_period_apart(tmp_path):
    (tmp_path / "log.csv").write_bytes(GOOD)
    layout = TextLayout(**{**PLAIN, "names": ["x", "p", "f"], "period": "20 ms"})
    read = read_table(tmp_path / "log.csv", layout, ["@time", "p"], (), ["x", "f"])
    assert read.columns["@time"].tolist() == [0.0, 0.02, 0.04]
    assert read.columns["p"].tolist() == [1.5, 2.5, 3.5]
