"""Free contraction of the simulated contractors against the table computed from paper 2's equations 1 and 2."""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.base.errors import InvalidFile
from pmabench.kinds.free_contraction.figures import half_pressure, rounding
from pmabench.kinds.free_contraction.reduction import reduce
from pmabench.store.records import Flag
from tests.analysis.driven_runs import ROOT, planned, recorded
from tests.analysis.test_honesty import unexplained

SHORT = (("sample_rate", "50 Hz"), ("prepare.precondition.cycles", "0"), ("sweep.repeat.count", "1"))
PRESSURES = [0, 20, 24, 28, 32, 36, 40, 50, 60, 70, 80, 90, 100, 110, 120, 130, 140, 160, 200, 250, 300, 400, 500]
BELOW = (*SHORT, ("trial.approach", "from-below"), ("trial.hold", "2.5 s"), ("trial.rest", "1.5 s"),
         ("sweep.matrix.pressure", f"[{', '.join(f'{P} kPa' for P in PRESSURES)}]"))  # fmt: skip
TABLE = {
    15: ((26.8, 32.2, 34.1, 35.9), 0.54),
    20: ((18.4, 26.3, 29.0, 31.3), 0.85),
    25: ((11.9, 21.7, 25.1, 28.0), 1.13),
    30: ((8.5, 18.9, 22.7, 26.1), 1.30),
    40: ((11.5, 19.6, 23.1, 26.4), 1.13),
}
"""Length [cm] -> contraction [%] at 1, 2, 3, 5 bar, and pressure of half the contraction [bar], both as rounded."""


def bench_of(cm):
    return "mock-contractor-free-ideal" if cm == 30 else f"mock-contractor-{cm}-free-ideal"


def value(analysis, symbol, coordinate="", **at):
    (found,) = [
        e
        for e in analysis.estimates
        if (e.symbol, e.coordinate) == (symbol, coordinate) and all(e.at[name] == at[name] for name in at)
    ]
    return found


def sigmoid(p, L0):
    """Paper 2 eqs. 1-2 with the exponent -0.248; p [bar], L0 and length [cm]."""
    a = 0.4351 * L0 + 0.0183 * L0**2 - 0.0003 * L0**3
    c = -0.0141 * L0 + 0.0031 * L0**2 - 0.00006 * L0**3
    d = 0.5487 * L0 - 0.0136 * L0**2 + 0.00007 * L0**3
    e = 0.3694 * L0**-0.248
    return a + (L0 - a) / (1 + (p / c) ** d) ** e - 0.009 * L0 * np.sqrt(p), (a, L0 - a, c, d, e)


@pytest.mark.parametrize(
    "cm", [pytest.param(cm, marks=() if cm in (min(TABLE), max(TABLE)) else pytest.mark.study) for cm in TABLE]
)
def test_each_length_of_paper_2_contracts_as_its_equations_say(tmp_path, cm):
    run = recorded(tmp_path, "free-contraction", bench_of(cm), f"contractor-{cm}", *BELOW)
    found = reduce([run])
    shares, half = TABLE[cm]
    for bar, share in zip((1, 2, 3, 5), shares, strict=True):
        L = value(found, "L", pressure=bar * 1e5).value
        assert 100 * (1 - L / (cm / 100)) == pytest.approx(share, abs=0.06)
    assert value(found, "L", pressure=0.0).value == pytest.approx(cm / 100, abs=1e-5), "a + b = L0"
    for e in found.estimates:
        if e.symbol == "L" and not e.coordinate:
            assert e.value == pytest.approx(sigmoid(e.at["pressure"] / 1e5, cm)[0] / 100, abs=50e-6)
    assert value(found, "P_half").value / 1e5 == pytest.approx(half, abs=0.01)
    for name, true, unit in zip("abcde", sigmoid(1.0, cm)[1], (1e-2, 1e-2, 1e5, 1, 1), strict=True):
        assert value(found, "L", name).value == pytest.approx(true * unit, rel=5e-3)
    (trace,) = found.traces
    curve = np.isfinite(trace.columns["fit"])
    true = sigmoid(trace.columns["pressure"][curve] / 1e5, cm)[0] / 100
    assert np.abs(trace.columns["fit"][curve] - true).max() < 1e-4, "refit within 0.1 mm"
    assert trace.columns["model"][curve] == pytest.approx(true, abs=1e-9)
    assert unexplained(found) == []


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """With noise, from both sides, two repeats."""
    few = ("sweep.matrix.pressure", "[0 bar, 0.4 bar, 0.7 bar, 0.8 bar, 1 bar, 1.3 bar, 2 bar, 3 bar, 5 bar]")
    settings = (*SHORT[:2], ("sweep.repeat.count", "2"), few)
    return recorded(
        tmp_path_factory.mktemp("both"), "free-contraction", "mock-contractor-free", "contractor-30", *settings
    )


def test_both_sides_and_repeats_give_intervals_that_hold_the_truth(both):
    found = reduce([both])
    assert len(both.trials) == 36
    for bar in (0.7, 1.0, 2.0, 5.0):
        L = value(found, "L", pressure=bar * 1e5)
        assert L.n == 2
        assert L.ci95[0] <= sigmoid(bar, 30)[0] / 100 <= L.ci95[1]
    assert value(found, "x_H", pressure=1e5).value == pytest.approx(0.0, abs=20e-6), "this plant has no hysteresis"
    assert value(found, "P_half").ci95[0] < 1.30e5 < value(found, "P_half").ci95[1]
    assert not [f for f in found.findings if f.level != "note"]
    assert unexplained(found) == []


def test_zeros_of_several_days_are_no_other_form(both):
    """Pressures split over three days with a zero each, within what is declared: a to e were withheld."""
    channels = both.channels | {"pressure": replace(both.channels["pressure"], offset_uncertainty=1.5e3)}
    days = []
    for day, zero in enumerate((1.2e3, -1.2e3, 0.4e3)):
        trials = [
            replace(trial, channels=trial.channels | {"pressure": trial.channels["pressure"] + zero})
            for trial in both.trials
            if sorted({t.point["pressure"] for t in both.trials}).index(trial.point["pressure"]) % 3 == day
        ]
        days.append(replace(both, id=f"d{day}", manifest={}, channels=channels, trials=tuple(trials)))
    found = reduce(days)
    for name, true, unit in zip("abcde", sigmoid(1.0, 30)[1], (1e-2, 1e-2, 1e5, 1, 1), strict=True):
        low, high = value(found, "L", name).ci95
        assert low < true * unit < high
    assert value(found, "L", "c").parts.combined < 0.1 * 0.747e5


def changed(run, change):
    trials = []
    for trial in run.trials:
        x = change(trial, trial.channels["displacement"])
        trials.append(replace(trial, channels={**trial.channels, "displacement": x}))
    return replace(run, trials=tuple(trials))


def test_hysteresis_is_reported_with_its_sign(both):
    """0.5 mm more contraction where it comes from above."""
    run = changed(both, lambda trial, x: x + 0.5e-3 * (trial.point["side"] > 0) * (x > 1e-3))
    found, before = reduce([run]), reduce([both])
    assert value(found, "x_H", pressure=1e5).value == pytest.approx(0.5e-3, abs=20e-6)
    mean = value(before, "L", pressure=1e5).value - 0.25e-3
    assert value(found, "L", pressure=1e5).value == pytest.approx(mean, abs=1e-6), "the mean of both sides"


def test_creep_a_wrong_zero_and_a_wrong_sign_are_reported(both):
    drifting = reduce([changed(both, lambda _, x: x + 0.2e-3 * (np.arange(len(x)) / 50) * (x > 0.01))])
    assert any("hold longer" in f.text for f in drifting.findings if f.level == "doubt")
    shifted = reduce([changed(both, lambda _, x: x + 1e-3)])
    assert any("1 mm of contraction are left" in f.text for f in shifted.findings if f.level == "doubt")
    turned = reduce([changed(both, lambda _, x: -x)])
    assert any("grows longer" in f.text for f in turned.findings if f.level == "fault")
    assert value(turned, "P_half").value is None


def test_no_sigmoid_is_fitted_to_lengths_that_none_comes_near(both):
    """Contractions that rise and fall from one pressure to the next."""
    places = sorted({trial.point["pressure"] for trial in both.trials})
    share = {P: (0.2, 1.0)[number % 2] for number, P in enumerate(places)}
    found = reduce([changed(both, lambda trial, x: share[trial.point["pressure"]] * x)])
    assert value(found, "L", "a").value is None
    assert value(found, "L", "a").note == "no fit: no sigmoid comes near these lengths"
    assert value(found, "L", pressure=1e5).value is not None


def test_what_cannot_be_used_is_dropped_with_its_reason(both):
    first, second, third, fourth, *rest = both.trials
    lacking = {name: values for name, values in third.channels.items() if name != "displacement"}
    bad = (
        replace(first, status="failed"),
        second,
        replace(third, channels=lacking),
        replace(fourth, flags=np.full(len(fourth.t), Flag.STALE, dtype=np.uint16)),
    )
    found = reduce([replace(both, trials=(*bad, *rest))])
    reasons = {d.trial.rpartition("/")[2]: d.reason for d in found.dropped}
    assert reasons == {
        "1": "the trial is failed",
        "2": "the other side of its repeat is lost",
        "3": "displacement not recorded",
        "4": "100% of the samples are flagged or missing",
    }
    assert value(found, "L", pressure=0.0).n == 1
    assert not reduce([replace(both, trials=())]).traces


def test_few_pressures_give_lengths_and_no_coefficients(both):
    run = replace(both, trials=tuple(t for t in both.trials if t.point["pressure"] in (0.0, 1e5, 5e5)))
    found = reduce([run])
    assert value(found, "L", pressure=1e5).value == pytest.approx(sigmoid(1.0, 30)[0] / 100, abs=1e-4)
    assert value(found, "L", "a").value is None
    assert value(found, "L", "a").note == "no fit: 3 pressures for 5 coefficients"


def test_the_print_is_rounded_by_centimetres():
    """Papers digest, T2.8."""
    reported = [100 * rounding(cm / 100) for cm in TABLE]
    assert reported == pytest.approx([0.18, 0.42, 0.81, 1.40, 3.28], abs=0.005)


def test_half_of_a_contraction_in_closed_form():
    P = np.linspace(0.0, 5e5, 26)
    assert half_pressure(P, 0.08 * P**2 / (P**2 + 1e10)) == pytest.approx((25 / 27) ** 0.5 * 1e5, rel=2e-3)
    assert half_pressure(P, np.zeros(26)) is None
    assert half_pressure(P[::-1], P[::-1]) is None


def specimen(tmp_path, length):
    text = (
        (ROOT / "fixtures/specimens/contractor-30.yaml").read_text().replace("300 mm", length).replace("35 %", "25 %")
    )
    path = tmp_path / "specimen.yaml"
    path.write_text(text)
    return path.with_suffix("")


@pytest.mark.parametrize(("length", "bench"), [("12 cm", 15), ("50 cm", 40)])
def test_lengths_that_paper_2_does_not_cover_are_refused(tmp_path, length, bench):
    path = specimen(tmp_path, length)
    settings = () if length == "12 cm" else (("sweep.matrix.pressure", "[1 bar]"),)
    with pytest.raises(InvalidFile, match="150 mm to 400 mm") as refused:
        planned("free-contraction", bench_of(bench), str(path), *settings)
    assert "compare: nothing" in str(refused.value)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("sweep.matrix.pressure", "[510 kPa]"), "up to which paper 2's length holds"),
        (("trial.hold", "0 s"), "taken at rest"),
        (("trial.rest", "0.1 s"), "taken at rest"),
        (("trial.rate", "0 kPa/s"), "must be above zero"),
        (("sweep.matrix.pressure", "[-10 kPa]"), "below the limit for commanded pressure"),
    ],
)
def test_what_free_contraction_cannot_be(change, says):
    with pytest.raises(InvalidFile, match=says):
        planned("free-contraction", "mock-contractor-free-ideal", "contractor-30", change)


def test_a_contraction_that_would_trip_is_refused_before_anything_moves(tmp_path):
    """35.9 % at 5 bar of 15 cm, against a specimen of 35 %; 35.0 % is passed between 3.6 and 3.8 bar."""
    text = (ROOT / "fixtures/specimens/contractor-15.yaml").read_text().replace("37 %", "35 %")
    (tmp_path / "specimen.yaml").write_text(text)
    with pytest.raises(InvalidFile, match=r"380 kPa it is predicted .* the trip limit is 52\.5 mm") as refused:
        planned("free-contraction", bench_of(15), str(tmp_path / "specimen"))
    assert "at 360 kPa" not in str(refused.value)


def test_the_largest_contraction_is_that_of_the_highest_pressure(tmp_path):
    run = recorded(tmp_path, "free-contraction", bench_of(20), "contractor-20", *BELOW)
    e = value(reduce([run]), "eps_max")
    assert e.at == {"pressure": 5e5}
    assert 100 * e.value == pytest.approx(31.3, abs=0.06)  # the table's, at 5 bar
