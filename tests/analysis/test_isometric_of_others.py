"""Force over pressure at a set length: what another laboratory found with its own simulator, repeated with closed forms.

F = (2.6 - 0.026 x) (P - 23) - 9 x [N, kPa, mm], and a hysteresis over the pressure that turns within `w`:
dz/dP = (1 - z) / w while it rises, (1 + z) / w while it falls, F + h z. The middle of the loop is the truth.
"""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.kinds.isometric_pressurisation.reduction import reduce
from pmabench.store.reader import open_run
from tests.analysis.judged_forms import as_run, as_trials
from tests.importing import import_files
from tests.judge import held

MAP = """
schema: pmabench.map/1
name: isometric tests of a logger
source: made for this test
kind: isometric-pressurisation
file: {delimiter: comma, header: first line}
columns:
  t: {is: time, unit: s}
  p: {is: pressure, unit: kPa, expanded_uncertainty: 0.2 kPa}
  x: {is: displacement, unit: mm, contraction: {reading: rises, zero: 0 mm}, expanded_uncertainty: 0.01 mm}
  F: {is: force, unit: N, expanded_uncertainty: 0.5 N}
  set: {is: SET}
  n: {is: trial}
  length: {is: point, of: contraction, unit: mm}
sampling: {rate: [50 Hz, 2000 Hz], gap: 200 ms}
trials: {by: column}
specimen: {type: M20, serial: I-1, nominal_length: 250 mm}
"""
DT = 0.01
LENGTHS = (0.0, 5.0, 10.0, 20.0)


def staircase(step=100.0, hold=4.0):
    """Pressure set [kPa]: up and down, each step held."""
    up = np.arange(0.0, 501.0, step)
    return np.repeat([*up, *up[-2::-1]], round(hold / DT))


def ramps(rate=25.0):
    """Up and down at `rate` [kPa/s], with rests."""
    way = np.arange(0.0, 500.0, rate * DT)
    return np.concatenate([np.zeros(300), way, np.full(100, 500.0), 500.0 - way, np.zeros(300)])


def cycles(count=6):
    """As many ramps up and down in one test."""
    once = ramps(100.0)
    return np.concatenate([once] * count)


def filtered(values, tau):
    found, keep, state = np.empty(len(values)), np.exp(-DT / tau), values[0]
    for i, value in enumerate(values):
        state = value + (state - value) * keep
        found[i] = state
    return found


def pulled(P, x, h, w):
    """Force [N] at P [kPa] one after the other, shape (n,)."""
    z, found = 0.0, np.empty(len(P))
    for i in range(len(P)):
        change = P[i] - P[max(0, i - 1)]
        z += (np.sign(change) - z) * -np.expm1(-abs(change) / w)
        found[i] = -h * z
    return np.maximum((2.6 - 0.026 * x) * (P - 23.0) - 9.0 * x, 0.0) + found


def campaign(
    tmp_path, course, h, w=40.0, late=0.0, longer=lambda n: 0.0, rest=None, columns="pressure_command, unit: kPa"
):
    """Two tests at each length: the analysis of their file. `late`: the force by so much [s]; `longer`: a slip [mm].

    `rest`: the length without pressure [mm], else that of the test.
    """
    rng, rows = np.random.default_rng(5), []
    P = filtered(course, 0.1)
    t = DT * np.arange(len(P))
    for n, x in enumerate([*LENGTHS, *LENGTHS]):
        F = np.interp(t - late, t, pulled(P, x + longer(n), h, w))
        length = np.where((P < 1.0) & (rest is not None), rest or 0.0, x)
        whole = [t + n * (t[-1] + 5.0), P + rng.normal(0, 0.1, len(t)), length + rng.normal(0, 0.002, len(t)),
                 F + rng.normal(0, 0.2, len(t)), course, np.full(len(t), n + 1), np.full(len(t), x)]  # fmt: skip
        rows.append(np.column_stack(whole))
    np.savetxt(
        tmp_path / "log.csv", np.vstack(rows), fmt="%.6g", delimiter=",", header="t,p,x,F,set,n,length", comments=""
    )
    (tmp_path / "map.yaml").write_text(MAP.replace("SET", columns))
    (made,) = import_files([tmp_path / "log.csv"], tmp_path / "map.yaml", tmp_path / "runs")
    return reduce([open_run(made.path)])


def of(found, symbol, method=None):
    return [e for e in found.estimates if e.symbol == symbol and method in {None, e.method}]


def true_slope(e):
    return (2.6 - 26.0 * e.at["contraction"]) * 1e-3


def holds(e, truth):
    return e.value is None or abs(e.value - truth) <= e.parts.combined


@pytest.mark.parametrize(("h", "columns"), [
    (0.0, "ignore"), (3.0, "pressure_command, unit: kPa"), (12.0, "ignore"), (12.0, "pressure_command, unit: kPa"),
])  # fmt: skip
def test_of_a_staircase_the_holds_show_the_line(tmp_path, h, columns):
    """The way from hold to hold was taken for a ramp, and only the last: slopes were 3 to 11 % off, with +- 0.4 %."""
    found = campaign(tmp_path, staircase(), h, columns=columns)
    slopes = of(found, "m", "isometric-line")
    assert len(slopes) == len(LENGTHS)
    assert all(e.value is not None and holds(e, true_slope(e)) and e.parts.combined < 0.06 * e.value for e in slopes)
    blocked = of(found, "F_b")
    assert {round(e.at["pressure"] / 1e3) for e in blocked} == {100, 200, 300, 400, 500}, (
        "and nothing between the holds"
    )
    assert all(holds(e, 2.6e-3 * (e.at["pressure"] - 23e3)) for e in blocked)


@pytest.mark.parametrize("late", [0.002, 0.005, 0.02])
def test_a_force_that_is_late_opens_no_loop_between_holds(tmp_path, late):
    widths = of(campaign(tmp_path, staircase(), 0.0, late=late), "H")
    assert len(widths) == len(LENGTHS)
    assert all(abs(e.value) < 0.2 for e in widths), [(e.value, e.parts) for e in widths]


def test_ramps_that_follow_each_other_are_no_staircase(tmp_path):
    """Six up and down: all samples count, and the loop is that of the ramps."""
    found = campaign(tmp_path, cycles(), 6.0, w=5.0)
    assert all(holds(e, true_slope(e)) for e in of(found, "m", "isometric-line"))
    assert all(11.0 < e.value < 12.5 for e in of(found, "H"))
    assert {round(e.at["pressure"] / 1e3) for e in of(found, "F_b")} == set(range(50, 451, 50))


def test_an_end_that_is_moved_without_pressure_does_not_give_way(tmp_path):
    """The last hold of a staircase, at 0 kPa, lasts until the next length is set."""
    found = campaign(tmp_path, staircase(), 3.0, rest=0.0)
    assert not any("not isometric" in finding.text for finding in found.findings)
    assert not any("not isometric" in e.note for e in found.estimates)
    assert len([e for e in of(found, "m", "isometric-line") if e.value is not None]) == len(LENGTHS)


def test_one_step_up_and_down_shows_no_loop(tmp_path):
    course = np.concatenate([np.zeros(300), np.full(600, 500.0), np.zeros(300)])
    found = campaign(tmp_path, course, 0.0, late=0.005)
    assert all(e.value is None and "ramp, or hold at five" in e.note for e in of(found, "H"))


@pytest.mark.parametrize("h", [20.0, 40.0, 60.0])
def test_a_wide_loop_is_in_the_force_at_the_ends_of_the_pressures(tmp_path, h):
    """The larger it was, the smaller the interval: beyond a size no part was straight, and its turns were forgotten."""
    blocked = of(campaign(tmp_path, ramps(), h), "F_b")
    assert len(blocked) == 10
    assert all(holds(e, 2.6e-3 * (e.at["pressure"] - 23e3)) for e in blocked)
    assert blocked[-1].parts.combined > h


def test_a_slip_is_in_the_onset_too(tmp_path):
    """From the sixth test on 1 mm longer: the pressure at which the force begins is 5 kPa off."""
    found = campaign(tmp_path, ramps(), 0.0, longer=lambda n: -1.0 if n >= 5 else 0.0)
    for e in of(found, "p_0"):
        x = 1e3 * e.at["contraction"]
        assert holds(e, 1e3 * (23.0 + 9.0 * x / (2.6 - 0.026 * x)))
    assert any(e.value is None for e in of(found, "p_0", "force-threshold"))


def of_a_drifting_cell(course, seed, known=None):
    """Tests of a muscle that is slack without pressure, in closed form; `course` is what the cell gains, by test.

    It is given the number of the test and its time [s] over how long it lasts.
    """
    trials = held.campaign("clean", 1.0, seed)
    lasts = float(np.ptp(trials[0].t))
    drifting = [
        replace(one, channels={**one.channels, "force": one.channels["force"] + course(n, (one.t - one.t[0]) / lasts)})
        for n, one in enumerate(trials)
    ]
    known = None if known is None else {"force": {"offset_uncertainty": known}}
    return of(reduce([as_run("isometric-pressurisation", as_trials(drifting), held.RATE, {}, known)]), "H")


def evenly(_, share):
    return share


@pytest.mark.parametrize(("drift", "course"), [
    (0.0, evenly), (0.5, evenly), (1.0, evenly), (1.0, lambda _, share: (share > 0.5) * 1.0),
    (1.0, lambda n, share: -1.0 * (share > 0.1 * (n % 10))), (1.0, lambda n, share: 0.5 * (n + share)),
])  # fmt: skip
@pytest.mark.parametrize(("gap", "known"), [(20.0, 1.0), (6.0, None)])
def test_a_loop_is_known_to_the_drift_of_the_cell(monkeypatch, drift, course, gap, known):
    """Steps of 1 N in each test put H 5 half widths off, an even drift of 0.5 N a test withheld every one of 6 N."""
    monkeypatch.setattr(held, "GAP", gap)
    widths = of_a_drifting_cell(lambda n, share: drift * course(n, share), 0, known)
    assert len(widths) == len(held.CONTRACTIONS)
    for e in widths:
        assert e.value is not None
        assert abs(e.value - gap) <= e.parts.combined < 1.2 + 1.7 * drift


def test_a_drift_of_more_than_half_a_loop_withholds_it():
    widths = of_a_drifting_cell(lambda n, share: 5.0 * share, 1)
    assert len(widths) == len(held.CONTRACTIONS)
    assert all(e.withheld and "N more after the ramps than before" in e.note for e in widths)
    assert all("(an effect above 50 % is not left to an interval)" in e.note for e in widths)


def test_what_a_muscle_pulls_after_the_ramps_is_no_more_drift_than_its_cell_is_known_to(tmp_path):
    """It keeps half of the loop, 3 N, without pressure; the zero of the cell is known within 0.5 N."""
    for e in of(campaign(tmp_path, ramps(), 3.0, w=5.0), "H"):
        assert abs(e.value - 6.0) <= e.parts.combined < 0.8
