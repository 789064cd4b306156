"""Charts: what is left of a line, where names stand, and what small multiples have in common."""

import re

import numpy as np
import pytest

from pmabench.plotting.chart import BLUE, CROSSES, MARKS, SHAPES, Chart, Level, Series, closed, limits, small_multiples
from pmabench.plotting.drawing import STATIC, joined, level_names, needed, pieces, rows_needed
from pmabench.plotting.pictures import of_charts
from pmabench.plotting.wording import Frame
from pmabench.report.certificate.interactive import chart_data
from tests.report.test_svg import places

T = np.linspace(0, 10, 700)


def line(y, x=T, **looks):
    return Chart("time [s]", "force [N]", (Series("", x, y, BLUE),), **looks)


def drawn(chart):
    return joined([[chart]], "a chart")


@pytest.mark.parametrize("y", [np.exp(-T) * np.sin(9 * T), np.where(T > 5, 1.0, 0.0), T, np.abs(T % 2 - 1)])
def test_points_that_are_left_out_lie_on_the_line_that_is_drawn(y):
    kept = needed(100 * T, 100 * y, 0.1)
    assert {0, len(T) - 1} <= {*kept}
    assert len(kept) < 0.4 * len(T)
    every = 100 * (T + 1j * y)
    begin, along = every[kept[:-1]], np.diff(every[kept])
    share = np.clip(((every[:, None] - begin) / along).real, 0, 1)
    assert np.abs(every[:, None] - begin - share * along).min(axis=1).max() <= 0.1 + 1e-9


def test_a_loop_is_closed_and_keeps_its_turning_points():
    """Out along a straight line and back on it: the far end is needed, although it lies on the line of the others."""
    x = np.concatenate([np.linspace(0, 1, 50), np.linspace(1, 0, 50)])
    kept = needed(100 * x, 100 * x, 0.1)
    assert x[kept].max() > 0.97
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    loop = closed(Series("", np.sin(angle), np.cos(angle), BLUE))
    (across, down) = pieces(Chart("x", "y", (loop,)), loop)[0]
    assert (across[0], down[0]) == pytest.approx((across[-1], down[-1]))


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4 * STATIC + 2])
@pytest.mark.parametrize("mark", ["", "o", "."])
def test_first_and_last_point_stay(count, mark):
    series = Series("", np.arange(float(count)), np.sin(np.arange(float(count))), BLUE, mark)
    chart = Chart("x", "y", (series,))
    assert [*rows_needed(chart, series)[[0, -1]]] == [0, count - 1] if count else not len(rows_needed(chart, series))
    for across, _ in [] if mark else pieces(chart, series):
        assert len(across) < STATIC + 3
        assert np.ptp(across) == pytest.approx(np.ptp(pieces(chart, series, count, 0.0)[0][0]), abs=1e-6)


def test_a_name_is_at_a_point_that_has_both_coordinates():
    x = np.append(T[:-1], np.nan)
    named = Chart(
        "t", "x", (Series("curve", x, T, BLUE), Series("nothing", x, np.where(np.isfinite(x), np.nan, 1), BLUE))
    )
    assert ">curve<" in drawn(named)
    assert "nan" not in drawn(named)


def test_the_longest_row_says_how_wide_a_picture_is():
    picture = of_charts([[line(T)], [line(T), line(T)]], "", "", Frame([{"a": "1"}]), simulated=False)
    assert picture.wide
    assert picture.layout == "grid"
    assert len(chart_data([(1, picture)])[0]["widths"]) == 2


def test_a_line_ends_where_it_leaves_the_axes():
    """sin(t) at limits of half its size crosses them at 30 degrees and at the same places of each half wave."""
    t = np.linspace(0, 3 * np.pi, 700)
    chart = line(np.sin(t), t, ends=(0.0, t[-1], -0.5, 0.5))
    found = pieces(chart, chart.series[0], most=700, near=0.0)
    left, right = (limit for limit in (found[0][0][0], found[-1][0][-1]))
    seconds = [(across - left) / (right - left) * t[-1] for across, _ in found]
    assert seconds[0][-1] == pytest.approx(np.pi / 6, abs=1e-3)
    assert [seconds[1][0], seconds[1][-1]] == pytest.approx([5 * np.pi / 6, 7 * np.pi / 6], abs=1e-3)
    heights = np.concatenate([down for _, down in found])
    assert np.ptp(heights) == pytest.approx(np.ptp(found[1][1]), abs=1e-6), "from edge to edge"


def test_equal_ratios_are_equally_far_apart_on_a_logarithmic_axis():
    f = np.array([0.1, 0.2, 0.4, 0.8, 8.0])
    dots = Chart("f [Hz]", "K", (Series("", f, f, BLUE, "o"),), log=True, x_ticks=tuple(f))
    across = [float(x) for x in re.findall(r'<circle cx="([\d.]+)"', drawn(dots))]
    apart = np.diff(across)
    assert apart[:3] == pytest.approx(apart[0], abs=0.02)
    assert apart[3] == pytest.approx(apart[0] * np.log(10) / np.log(2), abs=0.05)
    assert [text for text in (">0.1<", ">0.2<", ">0.8<", ">8<") if text not in drawn(dots)] == []


def test_small_multiples_have_the_same_axes_and_labels_at_the_edge_alone():
    charts = [line(n * np.sin(T), title=f"panel {n}", height=120.0) for n in (1, 2, 3, 4)]
    rows = small_multiples([(chart, line(np.cos(T))) for chart in charts], 3)
    assert [len(row) for row in rows] == [2, 2, 2, 2], "as full as each other"
    assert {limits(row[0]) for row in rows[::2]} == {limits(row[1]) for row in rows[::2]}
    assert [[chart.y_named for chart in row] for row in rows] == [[True, False]] * 4
    assert [[chart.x_named for chart in row] for row in rows] == [[False] * 2, [True] * 2] * 2
    text = joined(rows, "four")
    assert text.count("force [N]") == 4
    frames = [float(end) - float(start) for start, end in re.findall(r'<path d="M([\d.]+) [\d.]+L([\d.]+) [\d.]+" stroke="#52606d" stroke-width="0.9"', text) if float(end) - float(start) > 9]  # fmt: skip
    assert len(frames) == 8
    assert np.ptp(frames) < 0.05


def test_with_scales_of_its_own_each_has_its_labels():
    (row,) = small_multiples([line(n * T) for n in (1, 100)], 2, common="")
    assert [chart.y_named for chart in row] == [True, True]
    assert limits(row[0])[3] < 0.02 * limits(row[1])[3]


def test_titles_that_do_not_fit_make_fewer_columns_and_are_cut_at_last():
    charts = [line(T, title="400 kPa, 5 mm, 400 mm/s, 2 cycles") for _ in range(4)]
    assert [len(row) for row in small_multiples(charts, 4)] == [2, 2]
    (row,) = small_multiples([line(T, title="word " * 40)], 1)
    assert "…" in joined([row], "long")


def test_the_name_of_a_level_covers_no_curve():
    """A ramp from below the level to above it, early or late: the name is where the curve is not."""
    for begin in (1.0, 8.0):
        ramp = np.clip((T - begin) / 0.5, 0, 1) + 0.02 * T
        chart = line(ramp, levels=(Level(0.99, "lift 0.99"), Level(0.9, "set-down 0.9")))
        text = drawn(chart)
        curve = max((places(path) for path in re.findall(r'd="([^"]+)" fill="none"', text)), key=len)
        across = np.linspace(curve[:, 0].min(), curve[:, 0].max(), 3000)
        down = np.interp(across, curve[:, 0], curve[:, 1])
        boxes = []
        for level, x, y, right, _ in level_names(chart):
            first = x if right else x - 4 * len(level.name)
            inside = (across > first) & (across < first + 4 * len(level.name))
            assert not ((down[inside] > y - 6) & (down[inside] < y)).any(), (begin, level.name)
            boxes.append((first, y))
        assert abs(boxes[0][1] - boxes[1][1]) > 7 or abs(boxes[0][0] - boxes[1][0]) > 40


def test_a_span_is_shaded_and_limits_hold_the_levels():
    chart = line(np.sin(T), levels=(Level(3.0, "limit"), Level(2.0, to=4.0, upright=True)))
    assert limits(chart)[3] > 3.0
    (x, wide) = re.search(r'<rect x="([\d.]+)" y="[\d.]+" width="([\d.]+)"', drawn(chart)).groups()
    left, right = (
        float(re.search(pattern, drawn(chart))[1]) for pattern in (r'"M([\d.]+) [\d.]+L', r'"M[\d.]+ [\d.]+L([\d.]+)')
    )
    assert (float(x) - left, float(wide)) == pytest.approx((0.2 * (right - left), 0.2 * (right - left)), abs=0.1)


def test_marks_differ_without_their_colours():
    """Any two shapes, of own and of published values, have other outlines; a hollow one is white inside."""
    found = set()
    for mark in (*MARKS, *CROSSES, "."):
        for hollow in (False, True) if mark in MARKS else (False,):
            dot = Chart("x", "y", (Series("", np.ones(1), np.ones(1), BLUE, mark, hollow=hollow),))
            found.add(re.search(r"<circle[^>]*>|<path (?!d=\"M[\d.]+ [\d.]+L)[^>]*>", drawn(dot))[0])
    assert len(found) == 2 * len(MARKS) + len(CROSSES) + 1
    assert {*SHAPES} == {*MARKS[1:], *CROSSES}


def test_a_name_is_in_the_strip_once_whatever_the_number_of_charts():
    curve = Series("measured", T, T, BLUE)
    rows = small_multiples([Chart("t", "x", (curve,), legend=True) for _ in range(3)], 3)
    assert joined(rows, "three").count(">measured<") == 1


def test_thousands_of_samples_are_few_letters():
    rng = np.random.default_rng(1)
    cloud = Chart("x", "y", (Series("", rng.uniform(0, 1, 5000), rng.uniform(0, 1, 5000), BLUE, "."),))
    assert len(drawn(cloud)) < 20 * 5000
    noise = line(rng.normal(0, 1, 20_000), np.arange(20_000.0))
    assert len(drawn(noise)) < 20 * STATIC
