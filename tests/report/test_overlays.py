"""Published points beside one's own: where they are drawn, what is compared, and what matches nothing."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from pmabench.base.errors import InvalidFile
from pmabench.cli.main import main
from pmabench.cli.report import read_overlays
from pmabench.report.document.content import content_of
from pmabench.report.overlays import Published, comparison_table, with_published
from pmabench.store.analyses.folder import write_analysis
from pmabench.store.analyses.results import Analysis, Estimate, Trace
from tests.report.samples import all_analyses, contraction, render, static_load, truth

P = np.array([1e5, 2e5, 3e5, 4e5, 7e5])
BOOK = Published(
    "Book", "A book, page 3", Path("book.csv"), {"pressure": P, "K": np.array([truth("K", p) for p in P]) * 1.1}
)


def mean_curve(at=3e5):
    """A straight force over displacement at one pressure, 1000 N to 500 N in 50 mm."""
    x = np.linspace(0, 0.05, 101)
    columns = {"displacement": x, "force": 1000 - 1e4 * x}
    marks = {"pressure": at}
    return Trace(
        "mean-curve-1", "mean-curve", "300 kPa: mean", columns, {"displacement": "length", "force": "force"}, marks
    )


def ramps(*traces):
    e = Estimate("K", 1e4, "N/m", "stiffness", "mean-curve", {"pressure": 3e5})
    return Analysis("isobaric-ramp", ("r1",), simulated=True, estimates=(e,), traces=traces)


def test_a_coefficient_is_compared_at_the_published_pressures_within_its_range():
    """(K - 1.1 K) / (1.1 K) is -1/11; 100 and 700 kPa are outside of 150 to 500 kPa."""
    _, (theirs,), (row,) = with_published([contraction()], [BOOK], None)
    assert [e.at["pressure"] for e in theirs.estimates] == P.tolist()
    assert {e.method for e in theirs.estimates} == {"Book"}
    assert (row.name, row.label, row.points, row.places) == ("K", "Book", 3, "200 to 400 kPa")
    assert row.mean == pytest.approx(-1 / 11, rel=1e-3)
    assert row.size == pytest.approx(1 / 11, rel=1e-3)
    assert comparison_table([row])["mean difference [%]"] == ["−9.09"]


def test_values_that_stand_in_another_figure_are_not_compared():
    """K at several contractions is no K over pressure."""
    local = [
        Estimate("K", 1e4 * n, "N/m", "stiffness", "local", {"pressure": 3e5, "contraction": 0.01 * n}) for n in (1, 2)
    ]
    with pytest.raises(InvalidFile, match="matches no figure"):
        with_published([Analysis("isobaric-ramp", (), simulated=False, estimates=tuple(local))], [BOOK], None)


def test_own_results_stay_what_they_are():
    own = all_analyses()
    reported, theirs, _ = with_published(own, [BOOK], None)
    assert [a.to_dict() for a in reported] == [a.to_dict() for a in own]
    assert [a.kind for a in theirs] == ["published"]


def test_force_over_contraction_is_matched_by_pressure_and_the_length_of_the_specimen():
    eps = np.array([-0.5, 0.0, 0.05, 0.10, 0.20, 0.10, 0.40])
    pressure = np.array([3e5, 3e5, 3e5, 3.01e5, 3e5, 4e5, 3e5])
    own = 1000 - 1e4 * 0.25 * eps
    table = Published("Chart", "", Path("c.csv"), {"contraction": eps, "pressure": pressure, "force": own / 0.8})
    (reported,), _, (row,) = with_published([ramps(mean_curve())], [table], 0.25)
    (points,) = reported.traces[0].published
    assert points.columns["displacement"].tolist() == pytest.approx([0, 0.0125, 0.025, 0.05])  # 3.01 bar is near
    assert row.points == 4
    assert row.mean == pytest.approx(-0.2)
    assert row.over == "contraction at pressure 300 kPa"
    with pytest.raises(InvalidFile, match="force"):
        with_published([ramps(mean_curve(2e5))], [table], 0.25)


def test_branches_count_by_their_mean():
    """A loop of 30 N either side about a straight line: what is published on the line differs by nothing."""
    x = np.concatenate([np.linspace(0, 0.05, 500), np.linspace(0.05, 0, 500)])
    force = 1000 - 1e4 * x + np.repeat([-30.0, 30.0], 500)
    marks = {"pressure": 3e5, "frequency": 0.5}
    loop = Trace("loop-1", "loop", "", {"displacement": x, "force": force}, {}, marks)
    fast = Trace("loop-2", "loop", "", {"displacement": x, "force": 2 * force}, {}, {**marks, "frequency": 2.0})
    at = np.linspace(0, 0.05, 6)
    columns = {"displacement": at, "pressure": np.full(6, 3e5), "force": 1000 - 1e4 * at}
    _, _, rows = with_published([ramps(fast, loop)], [Published("Line", "", Path("l.csv"), columns)], None)
    (row,) = rows  # the slowest alone
    assert row.over.endswith("300 kPa, 0.5 Hz")
    assert row.points == 6
    assert row.size == pytest.approx(0, abs=1e-3)


def test_a_table_that_matches_nothing_is_reported_with_what_is_read():
    table = Published("Chart", "", Path("c.csv"), {"contraction": np.zeros(2), "force": np.ones(2)})
    with pytest.raises(InvalidFile) as caught:
        with_published([ramps(mean_curve())], [BOOK, table], 0.25)
    (problem,) = caught.value.problems
    assert problem.path == "c.csv"
    assert "matches no figure of this report: it holds contraction, force" in problem.message
    assert problem.message.endswith("what is read: pressure, contraction, displacement, force, F_ce, K, B, B_c, B_r")


def test_hostile_labels_and_values_stay_text_and_make_a_report():
    odd = np.array([np.nan, 1e12, -5.0, 0.0, 7.0])
    table = Published("<script>alert(1)</script>", "<b>&", Path("x"), {"pressure": P, "F_ce": odd})
    text = render([static_load()], [], published=[table])
    assert "<script>alert" not in text
    assert "&lt;b&gt;&amp;" in text


def test_the_table_on_the_page_is_one(tmp_path):
    page = (Path(__file__).resolve().parents[2] / "docs" / "published.md").read_text()
    (text,) = (block for block in page.split("```\n") if block.startswith("# Catalogue"))
    (tmp_path / "chart.csv").write_text(text)
    (table,) = read_overlays([f"{tmp_path / 'chart.csv'}:Chart"])
    assert table.columns["pressure"].tolist() == [2e5, 2e5]
    assert table.columns["contraction"].tolist() == [0, 0.05]
    assert table.source == "Catalogue of the maker, 2019, page 12, read off the chart"


# -- from the command line -----------------------------------------------------------------------------------------


def report(tmp_path, *overlays, code=0):
    folder = write_analysis(contraction(), tmp_path / "analysis")
    options = [item for text in overlays for item in ("--overlay", text)]
    page = tmp_path / "report.html"
    result = CliRunner().invoke(main, ["report", str(folder), "-o", str(page), *options])
    assert result.exit_code == code, result.output
    return page.read_text() if code == 0 else result.stderr


def test_overlays_are_read_with_their_units_and_labels(tmp_path):
    book = tmp_path / "book.csv"
    rows = "".join(f"{p / 1e5},{truth('K', p) * 1.1},{truth('B_c', p) / 1e3 if p < 3e5 else ''}\n" for p in P)
    book.write_text("# A book, page 3\nP [bar],S [N/m],D_c [N.s/mm]\n" + rows)
    other = tmp_path / "chart.csv"
    other.write_text("P_kPa,F_ce_N,when\n200,160,2020\n300,270,2021\n")
    text = report(tmp_path, f"{book}:Book 2020", str(other))
    assert "Compared with published values" in text
    assert "Crosses: chart and Book 2020, not measured here." in text
    assert "−9.09" in text
    assert "A book, page 3" in text
    assert "The file names no source." in text
    assert ">chart<" in text  # the legend
    coefficients = text[text.index('id="coefficients"') : text.index('id="test-1"')]
    assert "Book 2020" not in coefficients


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("P [bar],K [N/mm]\n1,x\n2,y\n", 't.csv:2:3  K: "x" is no number'),
        ("P [bar],K [kPa]\n1,2\n", "no unit of stiffness"),
        ("P [bar],K\n1,2\n", "needs a unit of stiffness"),
        ("P [bar],L [mm]\n1,2\n", "a coordinate and a value over it are expected"),
        ("P [bar],K [N/mm],S [N/mm]\n1,2,3\n", "a second column of K"),
        (
            "eps [%],force [N]\n1,2\n",
            "matches no figure of this report: it holds contraction, force; what is read: pressure",
        ),
    ],
)
def test_tables_that_cannot_be_used_are_reported_with_their_place(tmp_path, text, reported):
    table = tmp_path / "t.csv"
    table.write_text(text)
    assert reported in report(tmp_path, str(table), code=3)


def test_files_that_are_not_there_and_labels_that_come_twice_are_reported(tmp_path):
    assert "none.csv  cannot be read" in report(tmp_path, str(tmp_path / "none.csv"), code=3)
    table = tmp_path / "t.csv"
    table.write_text("P [bar],K [N/mm]\n2,2\n")
    assert 'two are called "t"' in report(tmp_path, str(table), str(table), code=2)


def test_published_points_are_in_the_loops_of_the_first_page():
    x = np.concatenate([np.linspace(0, 0.05, 50), np.linspace(0.05, 0, 50)])
    force = 1000 - 1e4 * x + np.repeat([-30.0, 30.0], 50)
    loop = Trace(
        "loop-1",
        "loop",
        "Loop at 0.5 Hz, 300 kPa",
        {"displacement": x, "force": force},
        {"displacement": "length", "force": "force"},
        {"pressure": 3e5, "frequency": 0.5},
    )
    at = np.linspace(0, 0.05, 6)
    columns = {"displacement": at, "pressure": np.full(6, 3e5), "force": 1000 - 1e4 * at}
    content = content_of([ramps(loop)], [], published=[Published("Line of 2009", "", Path("l.csv"), columns)])
    assert any("Line of 2009" in item.picture.svg for item in content.front)
