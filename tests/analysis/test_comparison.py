"""Two analyses against each other: E_n by hand, on the simulated bench, and what cannot be compared in words."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pmabench.analysis.verdict.comparison import Side, compare, named, not_accepted
from pmabench.base.errors import UsageError
from pmabench.cli.report import read_overlays
from pmabench.kinds.contraction_relaxation import reduction as contraction
from pmabench.kinds.contraction_relaxation.segments import gather
from pmabench.report.other_pages import rows_of
from pmabench.report.overlays import with_published
from pmabench.store.analyses.results import PUBLISHED, Analysis, Estimate, Parts, Source
from tests.analysis.coverage_study import CHANNELS, campaign
from tests.analysis.simulate import contraction_run, rig

ROOT = Path(__file__).resolve().parents[2]
FILES = frozenset({("calibrations/F.yaml", "00")})
SAME = FILES | {("session", "1")}


def K(value, half, P=3e5, method="m", **parts):
    at = {} if P is None else {"pressure": P}
    return Estimate("K", value, "N/m", "stiffness", method, at, Parts(half, **parts), n=3)


def side(*estimates, name="A", run="r1", kind="contraction-relaxation", **more):
    return Side(name, (Analysis(kind, (run,), False, estimates),), **more)


def one(a, b, **options):
    (difference,) = compare(a, b, **options).differences
    return difference


def test_e_n_is_the_difference_over_the_root_of_the_squares():
    d = one(side(K(10.0, 3.0)), side(K(6.0, 4.0), name="B", run="r2"))
    assert (d.value, d.half, d.score, d.agrees) == (4.0, 5.0, pytest.approx(0.8), True)
    assert d.relative == pytest.approx(4 / 6)
    assert one(side(K(12.0, 3.0)), side(K(6.0, 4.0), name="B", run="r2")).agrees is False


def test_the_same_calibration_drops_out_and_another_does_not():
    a, b = K(10.0, 3.0, calibration=12.0), K(6.0, 4.0, calibration=12.0)
    same = side(a, calibrations=SAME), side(b, name="B", run="r2", calibrations=SAME)
    assert one(*same).half == pytest.approx(5.0)
    larger = side(replace(b, parts=Parts(4.0, calibration=24.0)), name="B", run="r2", calibrations=SAME)
    assert one(same[0], larger).half == pytest.approx(13.0)  # 3, 4 and 24 - 12
    other = replace(same[1], calibrations=frozenset({("calibrations/F.yaml", "11"), ("session", "1")}))
    assert one(same[0], other).half == pytest.approx((25.0 + 288.0) ** 0.5)
    unknown = replace(same[0], calibrations=frozenset()), replace(same[1], calibrations=frozenset())
    assert one(*unknown).half == pytest.approx((25.0 + 288.0) ** 0.5)
    by_another_way = side(replace(b, method="n"), name="B", run="r2", calibrations=SAME)
    assert one(same[0], by_another_way).half == pytest.approx((25.0 + 288.0) ** 0.5)


def test_without_a_session_calibrations_do_not_drop_out():
    """Zeros of two days, each right within U; they were beyond in 4 of 5 where only repeats were left."""
    zeros = np.random.default_rng(11).normal(0.0, 8.0 / 1.959964, (400, 2))
    parts = Parts(1.0, calibration=10.0)
    days = [[replace(K(50.0 + z, None, 1e5 + i), parts=parts) for i, z in enumerate(zs)] for zs in zeros.T]
    a, b = (side(*one_day, name=n, run=n, calibrations=FILES) for one_day, n in zip(days, "AB", strict=True))
    found = compare(a, b)
    assert found.differences[0].half == pytest.approx((1 + 1 + 2 * 100) ** 0.5)
    assert np.mean([d.agrees for d in found.differences]) > 0.92
    assert any("errors that both share count in both" in f.text for f in found.findings)
    taken = [replace(one, calibrations=SAME) for one in (a, b)]
    assert compare(*taken).differences[0].half == pytest.approx(2**0.5)


def test_the_same_run_with_another_calibration_of_one_channel_shares_none():
    """A cell that reads 1 % more, known to 1 % instead of 0.2 %: E_n was 2.0 where both intervals hold the truth."""

    def of(value, gain):
        halves = {"force, gain": gain, "force, offset": 1.0, "pressure, offset": 1.6, "pressure, gain": 0.6}
        lines = tuple(Source(f"calibration of {name}", "calibration", "B", half) for name, half in halves.items())
        return replace(K(value, 0.1, calibration=np.hypot.reduce([*halves.values()])), budget=lines)

    def recalibrated(number, **more):
        (analysis,) = side(of(277.8, 2.78), name="B").analyses
        scales = {"recalibrated": [{"channel": "force", "calibration": {"id": "F-2", "sha256": number}}, 7]}
        return Side("B", (replace(analysis, facts=scales),), **more)

    a = side(of(275.0, 0.55), calibrations=SAME)
    found = compare(a, recalibrated("11", calibrations=SAME))
    (d,) = found.differences
    assert d.half == pytest.approx(np.hypot(d.a.parts.combined, d.b.parts.combined))
    assert d.agrees
    bare = [
        replace(e, budget=(), note="no calibration part: the record gives no gain uncertainty")
        for e in (of(275, 0.55), of(277.8, 2.78))
    ]
    b = recalibrated("11", calibrations=SAME)
    b = replace(b, analyses=(replace(b.analyses[0], estimates=(bare[1],)),))
    d = one(side(bare[0], calibrations=SAME), b)
    assert d.half == pytest.approx(np.hypot(*(e.parts.combined for e in bare)))  # nothing tells the channels apart
    assert d.lacks == ("A", "B")
    again = compare(recalibrated("11", calibrations=SAME), replace(recalibrated("11", calibrations=SAME), name="C"))
    assert again.differences[0].half == pytest.approx(0.02**0.5)


@pytest.mark.parametrize(
    ("parts", "note", "lacking"),
    [
        ((None, None), "", "A and B"),
        ((0.5, None), "", "B"),
        ((0.5, 0.5), "incomplete calibration part: the record gives no gain uncertainty of force", "A and B"),
        ((0.5, 0.5), "", ""),
    ],
)
def test_a_cell_that_reads_2_percent_more_is_not_another_muscle_where_nobody_declared_its_scale(parts, note, lacking):
    a, b = (
        side(replace(K(value, 0.1, calibration=part), note=note), name=name, run=name, calibrations=frozenset())
        for name, value, part in (("A", 100.0, parts[0]), ("B", 102.0, parts[1]))
    )
    found = compare(a, b)
    (d,) = found.differences
    assert (d.agrees, " and ".join(d.lacks)) == (False, lacking)
    assert rows_of(a, b, [d])[1][0][-1] == ("differs, or its scale" if lacking else "differs")
    line = next(f.text for f in found.findings if f.text.startswith("K: differ by more than their interval"))
    assert line.endswith(f"; the interval is without the scales of {lacking}") is bool(lacking)
    warned = [f.text for f in found.findings if "a force cell or gauge that reads otherwise" in f.text]
    assert [f"in full, in {lacking}: " in text for text in warned] == [True] * bool(lacking)
    one_bench = compare(replace(a, calibrations=SAME), replace(b, calibrations=SAME))
    assert one_bench.differences[0].lacks == ()  # the same scale on both sides


@pytest.mark.study
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("wrong", [(), CHANNELS])
def test_two_campaigns_of_one_muscle_are_beyond_as_often_as_they_should(wrong):
    """100 pairs of 24 trials with the same sensors, and with sensors drawn anew; 31 coefficients each."""
    with ProcessPoolExecutor(2) as executor:
        reported = list(executor.map(partial(reduced, wrong), range(200), chunksize=5))
    known = SAME if not wrong else None
    within = []
    for a, b in zip(reported[::2], reported[1::2], strict=True):
        sides = Side("A", (a,), calibrations=known), Side("B", (replace(b, runs=("r2",)),), calibrations=known)
        within += [d.agrees for d in compare(*sides).differences if d.a.symbol != "F_c"]
    print(f"\n{np.mean(within):.4f} of {len(within)}")
    assert np.mean(within) >= 0.93  # what the method adds to both counts in both


def reduced(wrong, seed):
    """The analysis of one campaign, the primary method alone."""
    run = campaign(seed, wrong)
    found, _ = gather([run])
    estimates, curves = contraction.estimates_of(found, contraction.pool(found, {}))
    return Analysis("contraction-relaxation", ("r1",), True, tuple(estimates), tuple(curves))


def test_values_are_read_on_straight_lines_only_where_nothing_is_in_common():
    a = side(K(6.0, 1.0, 2e5), K(8.0, 3.0, 4e5), K(10.0, 1.0, 6e5))
    b = side(K(7.5, 2.0, 3e5), name="B", run="r2")
    d = one(a, b)
    assert (d.a.value, d.a.parts.combined, d.between) == (pytest.approx(7.0), pytest.approx(2.0), "a")
    assert d.half == pytest.approx(8**0.5)
    every = dict.fromkeys(vars(Parts()), 2.0)
    at = (2e5, 4e5, 6e5)
    a_parts = side(*(replace(K(6.0 + n, 1.0, P), parts=Parts(**every)) for n, P in enumerate(at)))
    read = one(a_parts, b).a.parts
    assert read.calibration == 2.0
    assert read.combined == pytest.approx(20**0.5)  # no part is lost on the line
    bare = replace(a_parts.analyses[0].estimates[0], parts=Parts(2.0))
    half_known = side(bare, *a_parts.analyses[0].estimates[1:])
    assert one(half_known, b).a.parts.calibration == 1.0  # declared at 400 kPa only: half of it at 300
    both = side(K(7.5, 2.0, 3e5), K(6.0, 1.0, 2e5), name="B", run="r2")
    assert [d.a.at["pressure"] for d in compare(a, both).differences] == [2e5]
    asked = compare(a, both, pressures=[2.5e5]).differences
    assert [(d.a.value, d.b.value) for d in asked] == [(pytest.approx(6.5), pytest.approx(6.75))]
    outside = compare(a, both, pressures=[2e5, 7e5])
    assert "not compared: K has no value in A at 700 kPa" in [f.text for f in outside.findings]


def test_the_bend_between_two_points_is_in_the_interval():
    """The same muscle, K bent: E_n was +2.3 from 250 and 450 to 350 kPa, +4.6 from 200 and 500 kPa."""

    def at(*pressures, **more):
        return side(*(K(5600 + 1e-3 * P + 9.7e-9 * P**2, 10.0, P) for P in pressures), **more)

    reference = at(3.5e5, name="B", run="r2")
    for pressures in ((2.5e5, 4.5e5, 5.5e5), (2e5, 3e5, 5e5), (1e5, 2e5, 5e5)):
        d = one(at(*pressures), reference)
        assert d.value > 10
        assert d.agrees
        assert d.half < 5 * d.value
    alone = one(at(2e5, 5e5), reference)
    assert alone.between == "a"
    assert alone.score is None, "nothing shows the bend between two points"


def test_without_an_uncertainty_on_both_sides_there_is_no_e_n():
    """E_n of ISO/IEC 17043 divides by both uncertainties; one alone gave -1403 for a value 3 % off."""
    a = side(K(6.0, 1.0, 2e5), K(8.0, 1.0, 4e5), K(10.0, 1.0, 6e5))
    table = side(K(6.5, None, 2e5), K(7.0, None, 3e5), name="Serres", run="", kind=PUBLISHED, published=True)
    found = compare(a, table)
    assert [(d.value, d.half, d.score) for d in found.differences] == [(-0.5, None, None), (0.0, None, None)]
    reported = (
        "no E_n: Serres gives no uncertainty, and E_n needs that of both sides; 2 of its 2 values lie in the interval"
    )
    assert any(reported in f.text for f in found.findings)
    one_bare = compare(side(K(6.0, None)), side(K(9.0, 1.0), name="B", run="r2"))
    assert one_bare.differences[0].score is None
    assert any(f.level == "doubt" and "has no interval on one side" in f.text for f in one_bare.findings)
    assert not_accepted(one_bare.differences, "E_n", 1.0) == [
        "K at 300 kPa: no E_n: it needs an interval of both, accepted 1"
    ]


def test_two_right_values_are_missed_once_in_twenty():
    draw = np.random.default_rng(7)
    many = 1500
    ours, theirs = (draw.normal(100.0, half / 1.959964, many) for half in (3.0, 4.0))
    a = side(*(K(v, 3.0, 1e5 + P) for P, v in enumerate(ours)))
    b = side(*(K(v, 4.0, 1e5 + P) for P, v in enumerate(theirs)), name="B", run="r2")
    beyond = sum(not d.agrees for d in compare(a, b).differences)
    assert 0.033 * many < beyond < 0.067 * many  # three standard deviations are 0.017


def test_what_is_missing_is_reported_and_not_compared():
    a = side(K(6.0, 1.0, 2e5), K(None, None, 3e5))
    b = side(K(6.0, 1.0, 2e5), K(7.0, 1.0, 3e5), name="B", run="r2")
    texts = [f.text for f in compare(a, b).findings]
    assert "not compared: K is not identifiable in A at 300 kPa" in texts
    F = replace(K(1.0, 1.0), symbol="F_ce", unit="N", quantity="force")
    with pytest.raises(UsageError, match=r"A holds K and B holds F_ce"):
        compare(a, side(F, name="B", run="r2"))
    twice = replace(a, analyses=a.analyses * 2)
    with pytest.raises(UsageError, match="several analyses of contraction-relaxation"):
        compare(twice, b)
    with pytest.raises(UsageError, match=r'B has no method "x"; it has m'):
        compare(a, b, ("m", "x"))


def test_methods_of_one_analysis_share_their_runs_and_that_is_reported():
    a = side(K(6.0, 1.0), K(9.0, 1.0, method="other"))
    found = compare(replace(a, name="m"), replace(a, name="other"), ("m", "other"))
    assert found.differences[0].value == -3.0
    assert any("same runs" in f.text for f in found.findings)


def test_tests_of_another_kind_are_compared_only_where_none_is_the_same():
    a = side(K(6.0, 1.0))
    other = side(K(7.0, 1.0), name="B", run="r2", kind="sinusoidal-displacement")
    assert one(a, other).value == -1.0
    both = Side("B", (*side(K(6.5, 1.0), run="r2").analyses, *other.analyses))
    assert [d.value for d in compare(a, both).differences] == [-0.5]


def test_what_is_beyond_the_limit_is_not_accepted():
    far = one(side(K(12.0, 3.0)), side(K(6.0, 4.0), name="B", run="r2"))
    assert not_accepted([far], "E_n", 1.0) == ["K at 300 kPa: E_n +1.20, accepted 1"]
    assert not_accepted([far], "E_n", 1.3) == []
    assert not_accepted([far], "difference", 0.02) == ["K at 300 kPa: difference +100 %, accepted 2 %"]
    bare = one(side(K(12.0, None)), side(K(6.0, None), name="B", run="r2"))
    assert not_accepted([bare], "E_n", 1.0) == ["K at 300 kPa: no E_n: it needs an interval of both, accepted 1"]


def test_the_simulated_muscle_of_serres_lies_on_the_published_lines():
    """Pressures at a break of a published line are none of these: K breaks at 314 kPa, B_r at 372."""
    (table,) = read_overlays([f"{ROOT / 'fixtures' / 'tables' / 'serres2009.csv'}:Serres 2009"])
    cells = [(load, P) for load in (100.0, 300.0, 500.0) for P in (2e5, 2.5e5, 4.5e5, 5e5)]
    own = contraction.reduce([contraction_run(rig("serres2009", "ideal"), cells)], {"replays": 2})
    _, (published,), _ = with_published([own], [table], None)
    found = compare(Side("A", (own,)), Side("Serres", (published,), published=True), pressures=[2e5, 4.5e5]).differences
    assert sorted(named(d) for d in found if d.a.symbol != "B_r") == sorted(
        f"{symbol} at {P} kPa" for symbol in ("F_ce", "K", "B_c") for P in (200, 450)
    )
    assert [named(d) for d in found if abs(d.relative) > 0.005] == []


@pytest.fixture(scope="module")
def benches():
    """One bench twice, and one whose force cell reads 3 % more: F_ce, K, B and F_c come out 3 % larger.

    Loads are forces without weight: against weights the cell would be known to read 3 % more.
    """
    cells = [(load, P) for load in (58.86, 156.96, 255.06) for P in (3e5, 4e5, 5e5)]
    first, again = (contraction_run(rig(hanging=False), cells, 1, seed, name) for seed, name in ((1, "r1"), (2, "r2")))
    gained = [
        replace(t, channels={**t.channels, "force": 1.03 * t.channels["force"]})
        for t in contraction_run(rig(hanging=False), cells, 1, 3, "r3").trials
    ]
    runs = {"first": first, "again": again, "gained": replace(again, id="r3", trials=tuple(gained))}
    return {
        name: Side(name, (contraction.reduce([run], {"replays": 4}),), calibrations=SAME) for name, run in runs.items()
    }


def test_the_same_bench_agrees_with_itself(benches):
    found = compare(benches["again"], benches["first"], ("measured-pressure",) * 2).differences
    assert len(found) >= 12
    assert sum(d.agrees is False for d in found) <= 2  # 5 % of 13; more than 2 in one of thirty
    assert max(abs(d.score) for d in found) < 2.5


def test_a_bench_that_truly_differs_is_found_with_the_true_size(benches):
    found = compare(benches["gained"], benches["first"], ("measured-pressure",) * 2).differences
    forces = [d for d in found if d.a.symbol in ("F_ce", "K", "B_c")]
    assert len(forces) == 9
    missed = [named(d) for d in forces if abs(d.value - 0.03 * d.b.value) > 1.5 * d.half]
    assert missed == []
    assert all(d.relative == pytest.approx(0.03, abs=0.006) for d in forces)
    assert [d.agrees for d in forces if d.a.symbol == "K"] == [False] * 3
