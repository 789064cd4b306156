"""Paper 1's reduction: the printed polynomials, the table of S and D, both conventions of F_ce, and what is refused.

Expected values: paper 1 eqs. 17-20 as printed, the table computed from them, and closed forms of single steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import pi, radians, sin, tan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pmabench.base.errors import InvalidFile, UsageError
from pmabench.kinds.contraction_relaxation.paper1 import DRIVEN, KIND, METHODS, reduce
from pmabench.kinds.contraction_relaxation.values import best_orders, curve, least, normal_of
from pmabench.kinds.reduce import reduce_runs
from pmabench.store.analyses.results import Analysis, Curve, Estimate
from pmabench.store.records import Array, ChannelInfo, ClockInfo, Command, Flag, RunData, TrialData

PRESSURES = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 5.5, 6.0]) * 1e5
PRINTED = {
    "K": (340, -490, -460, 340, 660, 16000, 45000),
    "B_c": (220, -350, -530, 770, 1400, 2500, 18000),
    "B_r": (-860, 1500, 3800, -5300, 380, 37000, 49000),
}
"""S, D of contraction, D of relaxation; highest power first (paper 1 eqs. 17-19)."""
TABLE = {
    "K": (26.65, 27.39, 30.99, 35.51, 40.22, 45.00, 49.89, 54.88, 59.85, 64.68, 69.59),
    "B_c": (17.35, 16.12, 16.29, 16.80, 17.35, 18.00, 18.90, 20.10, 21.53, 23.06, 24.71),
    "B_r": (10.09, 15.79, 20.93, 28.33, 38.05, 49.00, 60.08, 70.87, 81.84, 94.10, 108.70),
}
"""The same at the pressures, in N/mm and N.s/mm, computed from the print with four digits."""
LINES = {"K": (14133, 0.09069), "B_c": (13481, 0.01608), "B_r": (-17225, 0.19929)}
QUANTITY = {"K": ("N/m", "stiffness"), "B_c": ("N.s/m", "damping"), "B_r": ("N.s/m", "damping")}
R0, L0, THETA0, LOAD = 0.020, 0.305, radians(26.5), 5.0
RATE = 500.0
Law = Callable[[float], float]


def braid(P: float, x: float) -> float:
    """F_ce [N] by hand (paper 1 eqs. 5-10)."""
    return pi * R0**2 * P * (3 / tan(THETA0) ** 2 * (1 - x / L0) ** 2 - 1 / sin(THETA0) ** 2)


def table(symbol: str) -> Law:
    return lambda P: 1e3 * float(np.interp(P, PRESSURES, TABLE[symbol]))


def estimates(symbol: str, P: Array, y: Array) -> list[Estimate]:
    unit, quantity = QUANTITY[symbol]
    return [Estimate(symbol, float(v), unit, quantity, "m", {"pressure": float(p)}) for p, v in zip(P, y, strict=True)]


# -- polynomials -----------------------------------------------------------------------------------------------------


def test_centre_and_scale_are_mean_and_deviation_of_the_11_pressures():
    centre, scale = normal_of(PRESSURES)
    assert centre == pytest.approx(3.5e5)
    assert round(scale / 1e5, 4) == 1.6583


@pytest.mark.parametrize("symbol", sorted(PRINTED))
def test_the_refit_returns_the_printed_coefficients_to_their_digits(symbol: str):
    values = np.polyval(PRINTED[symbol], (PRESSURES - 3.5e5) / 1.6583e5)
    found = curve(estimates(symbol, PRESSURES, values), 6, normalised=True)
    assert found is not None
    assert [float(f"{term.value:.1e}") for term in reversed(found.terms)] == [float(c) for c in PRINTED[symbol]]
    assert {term.unit for term in found.terms} == {QUANTITY[symbol][0]}
    assert found.form == "order 6 in z"


@pytest.mark.parametrize("symbol", sorted(PRINTED))
def test_the_refit_of_the_rounded_table_misses_by_no_more_than_its_rounding(symbol: str):
    found = curve(estimates(symbol, PRESSURES, 1e3 * np.array(TABLE[symbol])), 6, normalised=True)
    assert found is not None
    z = (PRESSURES - 3.5e5) / 1.6583e5
    half_a_digit = 5.0 * np.sum(np.abs(np.linalg.pinv(z[:, None] ** np.arange(7))), axis=1)
    for term, printed, bound in zip(found.terms, PRINTED[symbol][::-1], half_a_digit, strict=True):
        assert abs((term.value or 0.0) - printed) < bound + 1e-3 * abs(printed), term.coordinate


@pytest.mark.parametrize("symbol", sorted(LINES))
def test_the_line_through_the_table_is_the_digests(symbol: str):
    found = curve(estimates(symbol, PRESSURES, 1e3 * np.array(TABLE[symbol])), 1)
    assert found is not None
    start, slope = (term.value for term in found.terms)
    assert start == pytest.approx(LINES[symbol][0], rel=5e-4)
    assert slope == pytest.approx(LINES[symbol][1], rel=5e-4)


def test_a_curve_is_refused_outside_its_pressures_with_the_reason():
    found = curve(estimates("B_r", PRESSURES, 1e3 * np.array(TABLE["B_r"])), 6, normalised=True)
    assert found is not None
    assert float(found.values(np.array(1e5))) == pytest.approx(10090, rel=1e-3)
    assert float(np.polyval(PRINTED["B_r"], (0.5e5 - 3.5e5) / 1.6583e5)) < 0, "what an extrapolation would give"
    with pytest.raises(UsageError, match="B_r is asked for at pressure 50 kPa; it was fitted from 100 kPa to 600 kPa"):
        found.values(np.array([2e5, 0.5e5]))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=8), st.floats(-2, 0), st.floats(0.01, 4))
def test_least_value_of_a_polynomial_is_that_of_a_dense_grid(terms: list[float], low: float, width: float):
    grid = np.polyval(terms[::-1], np.linspace(low, low + width, 4001))
    size = float(np.sum(np.abs(terms) * np.maximum(1, abs(low) + width) ** np.arange(len(terms)))) + 1e-300
    found = least(np.array(terms), (low, low + width))
    assert found <= grid.min() + 1e-9 * size
    assert found >= grid.min() - 1e-3 * size


def test_the_order_is_that_of_what_made_the_points():
    rng = np.random.default_rng(3)
    z = (PRESSURES - 3.5e5) / 1.6583e5
    noisy = 5e4 + 1e4 * z + 3e3 * z**2 + 100 * rng.standard_normal(11)
    assert best_orders(PRESSURES, noisy)[0] == 2
    assert best_orders(PRESSURES, 1e3 + PRESSURES)[0] == 1
    assert best_orders(PRESSURES, np.polyval(PRINTED["K"], z))[0] == 6
    assert best_orders(PRESSURES[:4], noisy[:4]) == []


# -- runs in closed form ---------------------------------------------------------------------------------------------


def single_steps(
    pressures: Sequence[float] = tuple(PRESSURES),
    at: str = "x0",
    S: Law | None = None,
    D_c: Law | None = None,
    D_r: Law | None = None,
    repeats: int = 1,
    jitter: float = 0.0,
    F_ce_at: str | None = None,
    orders: dict[str, int] | None = None,
    name: str = "r1",
) -> RunData:
    """The 22 records of paper 1 as closed forms; F_ce of the muscle at x = 0 or, frozen, at x_max (`at`)."""
    S, D_c, D_r = (law or table(symbol) for law, symbol in ((S, "K"), (D_c, "B_c"), (D_r, "B_r")))
    rng = np.random.default_rng(5)
    trials: list[TrialData] = []
    for repeat in range(repeats):
        for P in pressures:
            force = braid(P, 0.0)
            if at == "xmax":
                low, high = 0.0, L0
                for _ in range(200):
                    middle = 0.5 * (low + high)
                    low, high = (middle, high) if braid(P, middle) - LOAD > S(P) * middle else (low, middle)
                force = braid(P, low)
            x_max = (force - LOAD) / S(P) * (1 + jitter * rng.standard_normal())
            for way in (1, -1):
                tau = (D_c if way > 0 else D_r)(P) / S(P)
                t = np.arange(0.0, 0.2 + 16 * max(tau, 0.4), 1 / RATE)
                fade = np.exp(-np.maximum(t - 0.24, 0.0) / tau)
                x = x_max * (1 - fade) if way > 0 else x_max * fade
                new = t >= 0.24
                pressure = P * (new if way > 0 else ~new)
                point = {"load": LOAD, "mass": 0.5, "from": 0.0 if way > 0 else P, "pressure": P if way > 0 else 0.0}
                start = 100.0 * len(trials)
                command = Command(
                    start + 0.2, "pressure", "set", point["pressure"], point["from"], "contract" if way > 0 else "relax"
                )
                trials.append(
                    TrialData(
                        name, len(trials), point, repeat, False, "finished", start + t,
                        {"pressure": pressure.astype(np.float64), "displacement": x}, np.zeros(len(t), np.uint16),
                        (command,), {},
                    )
                )  # fmt: skip
    asked = {
        "method": "paper-1", "F_ce_at": F_ce_at or at, "orders": orders or {}, "radius": R0, "nominal_length": L0,
        "braid_angle": THETA0,
    }  # fmt: skip
    infos = {
        "pressure": ChannelInfo("pressure", "pressure", "Pa", 1.0, 0.0, -np.inf, np.inf),
        "displacement": ChannelInfo("displacement", "length", "m", 1.0, 0.0, -np.inf, np.inf),
    }
    return RunData(
        id=name, path="", kind="contraction-relaxation", status="finished", simulated=True, manifest={},
        plan={"settings": {"reduction": asked}}, events=(), channels=infos, rate=RATE, trials=tuple(trials),
    )  # fmt: skip


def of(analysis: Analysis, symbol: str, method: str) -> dict[float, Estimate]:
    return {e.at["pressure"]: e for e in analysis.estimates if (e.symbol, e.method) == (symbol, method)}


@pytest.mark.parametrize("at", ["x0", "xmax"])
def test_the_table_comes_back_in_the_convention_of_the_muscle(at: str):
    run = single_steps(at=at)
    (analysis,) = reduce_runs([run])
    assert analysis.kind == KIND
    assert analysis.estimates[0].method == METHODS[at]
    for symbol in ("K", "B_c", "B_r"):
        values = [e.value for e in of(analysis, symbol, METHODS[at]).values()]
        assert values == pytest.approx(1e3 * np.array(TABLE[symbol]), rel=2e-3), symbol


def test_conventions_must_not_be_mixed_and_are_named():
    """A muscle of one convention read in the other: S too low by the factors of the digest, 5.3."""
    analysis = reduce([single_steps(at="x0")])
    wrong = of(analysis, "K", METHODS["xmax"])
    for P, factor in ((1e5, 0.65), (3e5, 0.34), (6e5, 0.25)):
        assert (wrong[P].value or 0.0) / table("K")(P) == pytest.approx(factor, abs=0.005)
    assert all("not to be mixed" in e.note for e in wrong.values())
    strokes = [step["x_max"] for step in reduce([single_steps([1e5, 6e5], at="xmax")]).facts["steps"][::2]]
    assert 1e3 * np.array(strokes) == pytest.approx([24.3, 42.4], abs=0.05)


def test_relaxation_is_reported_as_a_reduction_only():
    analysis = reduce([single_steps()])
    notes = {e.note for e in analysis.estimates if e.symbol == "B_r" and e.method in METHODS.values()}
    assert all("before the release: a reduction only" in note for note in notes)
    assert not [e for e in analysis.estimates if (e.symbol, e.method) == ("B_r", DRIVEN)]


def test_the_fit_with_the_measured_pressure_is_next_to_and_agrees_where_the_pressure_is_a_step():
    analysis = reduce([single_steps()])
    for symbol in ("K", "B_c"):
        found = of(analysis, symbol, DRIVEN)
        assert list(found) == list(PRESSURES)
        assert [e.value for e in found.values()] == pytest.approx(1e3 * np.array(TABLE[symbol]), rel=5e-3)
    assert any("takes the pressure for a step" in f.text for f in analysis.findings)


def test_accuracy_is_that_of_paper_1_and_the_residual_is_next_to():
    """With lines instead of polynomials the ends are missed by what the line through S misses."""
    analysis = reduce([single_steps(orders={"K": 1, "B_c": 1, "B_r": 1})])
    line = next(c for c in analysis.curves if (c.symbol, c.method, c.form) == ("K", METHODS["x0"], "order 1 in z"))
    accuracy = {e.at["pressure"]: e for e in analysis.estimates if (e.symbol, e.coordinate) == ("accuracy", "")}
    for P in PRESSURES:
        x_s = (braid(P, 0.0) - LOAD) / float(line.values(np.array(P)))
        x_e = (braid(P, 0.0) - LOAD) / table("K")(P)
        assert accuracy[P].value == pytest.approx(1 - abs(x_s - x_e) / x_e, abs=1e-4)
    misfits = [e for e in analysis.estimates if e.symbol == "misfit"]
    assert len(misfits) == 22
    assert all((e.value or 0.0) > 0 for e in misfits)
    best = reduce([single_steps()])
    assert all(e.value == pytest.approx(1.0, abs=2e-3) for e in best.estimates if e.symbol == "accuracy")
    assert len([t for t in best.traces if t.figure == "step-overlay"]) == 22


def test_accuracy_with_a_pressure_left_out_is_that_of_a_fit_without_it():
    analysis = reduce([single_steps(orders={"K": 2})])
    left_out = {e.at["pressure"]: e for e in analysis.estimates if (e.symbol, e.coordinate) == ("accuracy", "left out")}
    assert list(left_out) == list(PRESSURES[1:-1]), "an end cannot be left out: nothing is told beyond the pressures"
    for out in (2, 7):
        rest = np.arange(11) != out
        S = np.polyval(np.polyfit(PRESSURES[rest] / 1e5, 1e3 * np.array(TABLE["K"])[rest], 2), PRESSURES[out] / 1e5)
        x_s, x_e = ((braid(PRESSURES[out], 0.0) - LOAD) / stiff for stiff in (S, 1e3 * TABLE["K"][out]))
        assert left_out[PRESSURES[out]].value == pytest.approx(1 - abs(x_s - x_e) / x_e, abs=1e-4)


def test_repeats_give_intervals_that_hold_the_truth():
    analysis = reduce([single_steps(PRESSURES[::5], repeats=4, jitter=0.01)])
    once = reduce([single_steps(PRESSURES[::5])])
    for symbol in ("K", "B_c", "B_r"):
        for P, e in of(analysis, symbol, METHODS["x0"]).items():
            assert e.n == 4
            low, high = e.ci95 or (np.inf, -np.inf)
            assert low < table(symbol)(P) < high
            assert 0.002 < (e.parts.repeats or 0.0) / (e.value or 1.0) < 0.06
            assert of(once, symbol, METHODS["x0"])[P].ci95 is None


def test_calibration_counts_gain_of_length_and_pressure():
    """S = (g P - L) / x: 1 % of x is 1 % of S, 1 % of P is 1 % of g P / x."""
    run = single_steps([2e5, 3e5, 4e5])
    for channel, share in (("displacement", 1.0), ("pressure", braid(3e5, 0.0) / (braid(3e5, 0.0) - LOAD))):
        infos = {**run.channels, channel: replace(run.channels[channel], gain_uncertainty=0.01)}
        found = of(reduce([replace(run, channels=infos)]), "K", METHODS["x0"])[3e5]
        assert (found.parts.calibration or 0.0) / (found.value or 1.0) == pytest.approx(0.01 * share, rel=1e-3)


# -- what is refused -------------------------------------------------------------------------------------------------


def test_a_step_below_1_bar_is_dropped_with_the_reason():
    low = single_steps([0.5e5, *PRESSURES], S=lambda P: 3e4, D_c=lambda P: 2e4, D_r=lambda P: 2e4)
    analysis = reduce([low])
    assert [d.point["pressure"] or d.point["from"] for d in analysis.dropped] == [0.5e5, 0.5e5]
    assert all("below 100 kPa" in d.reason for d in analysis.dropped)
    assert 0.5e5 not in of(analysis, "K", METHODS["x0"])
    assert all(c.domain[0] >= 1e5 for c in analysis.curves)


def test_an_order_that_the_pressures_do_not_bear_is_reported():
    analysis = reduce([single_steps(PRESSURES[:4], orders={"K": 6})])
    assert any("order 6 through K" in f.text and "needs 8 pressures, there are 4" in f.text for f in analysis.findings)
    assert [c.form for c in analysis.curves if (c.symbol, c.method) == ("K", METHODS["x0"])] == ["line"]


def broken(run: RunData, number: int, **changes: object) -> RunData:
    trials = list(run.trials)
    trials[number] = replace(trials[number], **changes)  # type: ignore[arg-type]
    return replace(run, trials=tuple(trials))


def test_what_cannot_be_read_is_dropped_with_its_reason():
    run = single_steps(PRESSURES[:5])
    first, n = run.trials[0], len(run.trials[0].t)
    still = {**first.channels, "displacement": np.zeros(n)}
    nothing = {**first.channels, "displacement": np.full(n, np.nan)}
    for changes, reason in (
        ({"channels": still}, "too little motion"),
        ({"channels": nothing}, "too few usable samples"),
        ({"commands": ()}, "no pressure is commanded"),
        ({"status": "aborted"}, "the trial is aborted"),
        ({"flags": np.full(n, Flag.STALE, np.uint16)}, "no sample is usable"),
    ):
        analysis = reduce([broken(run, 0, **changes)])
        assert [d.trial for d in analysis.dropped] == ["r1/1"]
        assert reason in analysis.dropped[0].reason
        assert 1e5 not in of(analysis, "K", METHODS["x0"])
        lost = of(analysis, "B_r", METHODS["x0"])[1e5]
        assert lost.value is None, "no S, no D"
        assert "no S of a contraction" in lost.note


def test_without_a_contraction_nothing_comes_out_and_it_is_said():
    run = single_steps(PRESSURES[:3])
    analysis = reduce([replace(run, trials=tuple(t for t in run.trials if t.point["from"] > 0))])
    assert analysis.estimates == ()
    assert analysis.findings[0].level == "fault"
    assert reduce([replace(run, trials=())]).findings[0].level == "fault"


def test_a_step_that_had_not_come_to_rest_is_doubted():
    run = single_steps(PRESSURES[:3])
    cut = run.trials[0].t < run.trials[0].t[0] + 0.2 + 3 * table("B_c")(1e5) / table("K")(1e5)
    channels = {name: values[cut] for name, values in run.trials[0].channels.items()}
    short = broken(run, 0, t=run.trials[0].t[cut], flags=run.trials[0].flags[cut], channels=channels)
    assert any(f.level == "doubt" and "still moved at their end, r1/1" in f.text for f in reduce([short]).findings)
    assert not any("still moved" in f.text for f in reduce([run]).findings)


@pytest.mark.parametrize(
    "change",
    [
        {"radius": None}, {"radius": "wide"}, {"radius": -0.02}, {"braid_angle": float("nan")}, {"F_ce_at": "x1"},
        {"orders": {"K": 0}}, {"orders": {"K": "many"}}, {"orders": 3},
    ],
)  # fmt: skip
def test_a_plan_that_does_not_show_the_geometry_is_refused_in_a_sentence(change: dict[str, object]):
    run = single_steps([3e5])
    asked = {**run.plan["settings"]["reduction"], **change}
    with pytest.raises(InvalidFile, match='the plan\'s "reduction" tells no radius'):
        reduce([replace(run, plan={"settings": {"reduction": asked}})])


def test_runs_of_another_geometry_are_not_mixed_in():
    one, two = single_steps(PRESSURES[:3]), single_steps(PRESSURES[:3], F_ce_at="xmax", name="r2")
    analysis = reduce([one, two])
    assert len(analysis.dropped) == 6
    assert all("reduce it apart" in d.reason for d in analysis.dropped)
    assert all(e.n <= 1 for e in analysis.estimates if e.symbol == "K" and e.method in METHODS.values())


def test_a_load_beyond_the_braids_force_leaves_no_stiffness():
    """Read at x_max, a muscle that contracts further than its braid can has no pull left there."""
    analysis = reduce([single_steps(PRESSURES[:3], S=lambda P: 6e3, D_c=lambda P: 3e3, D_r=lambda P: 3e3)])
    wrong = of(analysis, "K", METHODS["xmax"])
    assert [e.value for e in wrong.values()][1:] == [None, None]
    assert "no pull above the load" in wrong[2e5].note


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.floats(1e2, 1e5), min_size=11, max_size=11),
    st.lists(st.floats(1.0, 2e5), min_size=11, max_size=11),
    st.sampled_from([None, 2, 4, 6, 9]),
)
def test_no_curve_is_negative_anywhere_on_its_domain(stiff: list[float], damp: list[float], order: int | None):
    from pmabench.kinds.contraction_relaxation.paper1 import _curves

    members = estimates("K", PRESSURES, np.array(stiff)) + estimates("B_r", PRESSURES, np.array(damp))
    curves, findings = _curves(members, {} if order is None else {"K": order, "B_r": order})
    grid = np.linspace(1e5, 6e5, 3001)
    for one in curves:
        assert float(one.values(grid).min()) > 0
        for outside in (0.5e5, 0.0, 6.5e5):
            with pytest.raises(UsageError, match="means nothing outside"):
                one.values(np.array(outside))
    reported = {c.symbol for c in curves if c.normalised}
    assert all(symbol in reported or any(symbol in f.text for f in findings) for symbol in ("K", "B_r"))


def test_the_printed_damping_of_relaxation_would_be_negative_below_its_range():
    """Why 1 bar is the end: paper 1's captions go to 0 and 0.5 bar."""
    terms = np.array(PRINTED["B_r"][::-1], dtype=np.float64)
    ends = ((1e5 - 3.5e5) / 1.6583e5, (6e5 - 3.5e5) / 1.6583e5)
    assert least(terms, ends) == pytest.approx(10090, rel=1e-3)
    assert least(terms, ((0.5e5 - 3.5e5) / 1.6583e5, ends[1])) < 0


def test_a_curve_with_centre_and_scale_is_a_plain_one_without():
    plain = Curve("K", "line", (), "pressure", (0.0, 1.0), 1.0, 0.0, "m")
    assert not plain.normalised
    assert replace(plain, centre=1.0).normalised


def test_clocks_of_two_devices_count_where_pressure_and_displacement_meet():
    """tau and x_max are read in one channel; the fit with the measured pressure, here of lag T, needs both."""
    S, D, T, late = 4e4, 1.8e4, 0.1, 5e-3
    run = single_steps(PRESSURES[::2], S=lambda P: S, D_c=lambda P: D, D_r=lambda P: D)
    trials = []
    for trial in run.trials:
        since = np.maximum(trial.t - trial.t[0] - 0.24, 0.0)
        lagged = {
            "pressure": trial.point["pressure"] * -np.expm1(-since / T),
            "displacement": trial.channels["displacement"].max()
            * (1 - (D / S * np.exp(-since * S / D) - T * np.exp(-since / T)) / (D / S - T)),
        }
        trials.append(replace(trial, channels=lagged) if trial.point["from"] == 0 else trial)
    run = replace(run, trials=tuple(trials))
    infos = {name: replace(info, stream=name) for name, info in run.channels.items()}
    once = reduce([run])
    analysis, half = (
        reduce(
            [replace(run, channels=infos, clocks={"pressure": ClockInfo(uncertainty=u), "displacement": ClockInfo()})]
        )
        for u in (late, late / 2)
    )
    parts = {P: e.parts.skew for P, e in of(analysis, "B_c", DRIVEN).items()}
    assert [e.value for e in of(analysis, "B_c", DRIVEN).values()] == pytest.approx([D] * 6, rel=3e-3)
    assert all(0 < part < 0.1 * D for part in parts.values())
    assert of(half, "B_c", DRIVEN)[1e5].parts.skew == pytest.approx(parts[1e5] / 2, rel=0.2)
    assert all(e.parts.skew == 0 for e in analysis.estimates if e.method in METHODS.values())
    assert all(e.parts.skew == 0 for e in once.estimates)
