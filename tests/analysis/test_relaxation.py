"""Relaxation of the rubber: the closed form of the page, correlated noise, and the simulated muscle by hand.

F = F_1 (1 - s log10(t/1 s)). The plant is made of exponentials and knows no logarithm; what it comes to is added up here.
"""

import re
from dataclasses import replace
from math import exp, hypot, log10, pi, radians, sin, tan

import numpy as np
import pytest
from scipy.signal import lfilter

from pmabench.analysis.trial import Quick
from pmabench.base.errors import InvalidFile
from pmabench.kinds.relaxation.course import Course
from pmabench.kinds.relaxation.reduction import LINE, PRONY, one_trial, reduce
from pmabench.kinds.relaxation.relaxing import Relaxing
from pmabench.store.reader import open_run
from pmabench.store.records import Command, TrialData
from tests.analysis.driven_runs import planned, recorded
from tests.analysis.judged_forms import as_run
from tests.analysis.test_honesty import refuse_unexplained_moves
from tests.importing import import_files

SHORT = (("prepare.precondition.cycles", "0"), ("trial.hold", "120 s"), ("trial.rest", "360 s"),
         ("sweep.matrix.pressure", "[5 bar]"))  # fmt: skip


def law(t, F=500.0, s=0.02):
    return F * (1 - s * np.log10(t))


def test_the_closed_form_and_its_four_exponentials():
    """500, 490, 480, 470 N at 1, 10, 100, 1000 s; four exponentials follow it within 0.22 N."""
    assert law(np.array([1, 10, 100, 1000])).tolist() == [500, 490, 480, 470]
    t = np.linspace(1.0, 1000.0, 20_000)
    one = Relaxing(t, law(t))
    start, slope = one.line
    assert start == pytest.approx(500.0, abs=1e-3)
    assert -slope / start == pytest.approx(0.02, abs=1e-7)
    sizes, _, _ = one.prony
    assert (sizes >= 0).all()
    follows = sizes[0] + sum(size * np.exp(-t / T) for size, T in zip(sizes[1:], (1, 10, 100, 1000), strict=True))
    assert np.abs(one.means(follows - law(t))).max() < 0.35
    assert np.sqrt(np.mean(one.means(follows - law(t)) ** 2)) < 0.22


@pytest.mark.parametrize("tau", [0.0, 10.0])
def test_intervals_hold_the_slope_under_correlated_noise(tau):
    """Noise of 1 N over 300 s, white or with a correlation of 10 s: of 100 intervals at least 93 hold 2 %."""
    rng = np.random.default_rng(18)
    t = np.arange(5.0, 300.0, 0.1)
    keep = exp(-0.1 / tau) if tau else 0.0
    inside, bent, widths = 0, 0, []
    for _ in range(100):
        white = rng.standard_normal(len(t) + 1000) * (1 - keep**2) ** 0.5
        one = Relaxing(t, law(t) + lfilter([1], [1, -keep], white)[1000:])
        course = Course(trial=None, relaxing=one, raw=one, zero=0.0, noise=1.0, rise=0.0, off=0.0, before=())
        half = hypot(course.half, *(doubt.half for doubt in course.doubts()))
        inside += abs(course.per_decade - 0.02) <= half
        widths.append(half)
        bent += any(doubt.seen for doubt in course.doubts())
    assert inside >= 93, inside
    assert bent <= 2, "noise is taken for a bend"
    assert np.median(widths) < (0.0008 if tau == 0 else 0.006), "an interval that says nothing is none"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Paper 3's muscle at 0 and 20 mm, 5 bar, held for 120 s; its rubber passes on 2 % less in each decade."""
    return recorded(
        tmp_path_factory.mktemp("relaxing"), "relaxation", "mock-daerden-relaxing", "daerden-20-200", *SHORT
    )


def force(t, x, P=5e5):
    """Of muscle D by the formulas of paper 3 [N], the pressure 1 % lower with each of two times in each decade."""
    eps, theta = x / 0.2, radians(25)
    S = pi / 4 * 0.02**2 * (3 * (1 - eps) ** 2.6 / tan(theta) ** 2 - 1 / sin(theta) ** 2)
    rubber = 800 * eps * (eps - 0.22) / (eps + 0.04)
    turned = 30 * (1 - exp(-x / (0.006 * 0.2)))
    gone = sum(0.01 * (1 - exp(-t / 10 ** (k / 2))) for k in range(-2, 11))
    return S * P * (1 - gone) + rubber - turned


def test_the_simulated_muscle_relaxes_as_its_terms_add_up(run):
    found = reduce([run])
    for x in (0.0, 0.02):
        # the straight line over the decades from 5 to 120 s, through 60 places
        places = [5 * 24 ** (i / 59) for i in range(60)]
        slope, start = np.polyfit([log10(t) for t in places], [force(t, x) for t in places], 1)
        (s,) = (e for e in found.estimates if e.symbol == "s" and e.at["contraction"] == pytest.approx(x))
        assert s.method == LINE
        assert s.value == pytest.approx(-slope / start, abs=1e-3), "within 0.1 % per decade"
        assert s.ci95[0] <= -slope / start <= s.ci95[1]
        assert s.ci95[1] - s.ci95[0] < 4e-3
        (F,) = (e for e in found.estimates if e.symbol == "F_1" and e.at["contraction"] == pytest.approx(x))
        assert F.value == pytest.approx(start, rel=5e-3)
        assert F.ci95[0] <= start <= F.ci95[1]
    shown = {e.coordinate for e in found.estimates if e.method == PRONY and e.value is not None}
    assert shown == {"10 s", "100 s"}, "1 s is over when it begins, 1000 s is not reached"


def changed(run, F=None, P=None):
    """The run with other samples in its first trial: functions of time after the step, and of the samples."""
    trial = run.trials[0]
    t0 = next(c.t for c in trial.commands if c.output == "pressure" and c.phase == "step")
    t = np.maximum(trial.t - t0, 1e-3)
    channels = dict(trial.channels)
    for name, of in (("force", F), ("pressure", P)):
        if of is not None:
            channels[name] = of(t, channels[name])
    return replace(run, trials=(replace(trial, channels=channels),))


def s_of(found):
    return next(e for e in found.estimates if e.symbol == "s")


def test_the_measured_pressure_is_divided_out(run):
    """A regulator that sinks by 2 % of the pressure over the hold takes the force with it: s is the same."""

    def sinks(t, y):
        return y * (1 - 0.02 * np.minimum(t / 120, 1.0))

    base, sunk = s_of(reduce([changed(run)])), s_of(reduce([changed(run, sinks, sinks)]))
    alone = s_of(reduce([changed(run, sinks)]))
    assert sunk.value == pytest.approx(base.value, abs=2e-4)
    assert alone.value is None or abs(alone.value - base.value) > 5e-3, "it would be seen in s"
    assert sunk.ci95[1] - sunk.ci95[0] > base.ci95[1] - base.ci95[0], "what is divided out widens the interval"


def test_what_is_no_straight_line_is_withheld(run):
    """One exponential of 30 s, 5 % of the force: a slope over log t says nothing of it."""
    one = s_of(reduce([changed(run, lambda t, y: y * (1 + 0.05 * np.exp(-t / 30)))]))
    assert one.withheld
    assert "no straight line over log t" in one.note


def start_of(found):
    return next(e for e in found.estimates if e.symbol == "F_1")


@pytest.mark.parametrize("share", [0.002, 0.005, 0.01, 0.05])
def test_the_force_at_1_s_is_not_read_from_a_line_where_there_is_none(run, share):
    """One exponential of 30 s on top, from 5 s on: at 1 s it is there nearly whole, and the line does not know it."""
    plain, one = (start_of(reduce([changed(run, F)])) for F in (None, lambda t, y: y * (1 + share * np.exp(-t / 30))))
    assert one.withheld or one.ci95[0] <= plain.value * (1 + share * exp(-1 / 30)) <= one.ci95[1]
    assert one.withheld == (share == 0.05)


@pytest.mark.parametrize("drift", [2.0, 10.0, 60.0])
def test_a_cell_that_drifts_through_the_run_is_in_the_force(run, drift):
    """So much [N] over each trial of 120 s and the rest before it, of 1500 N: what it comes to by the second one."""

    def drifting(trial):
        off = drift * (trial.t - run.trials[0].t[0]) / 120
        return replace(trial, channels={**trial.channels, "force": trial.channels["force"] + off})

    plain, found = reduce([run]), reduce([replace(run, trials=tuple(map(drifting, run.trials)))])
    for at_first, one in zip(*([e for e in of.estimates if e.symbol == "F_1"] for of in (plain, found)), strict=True):
        assert one.withheld or one.ci95[0] <= at_first.value <= one.ci95[1]
        assert one.withheld == ((drift >= 10 and one.at["contraction"] > 0.01) or drift == 60)


def test_a_valve_that_empties_slowly_is_no_drift_of_the_cell(run):
    """2 % of the pressure, and of the force, are still there at the end of the trial."""
    trial = run.trials[0]
    vent = next(c.t for c in trial.commands if c.phase == "vent")
    step = next(c.t for c in trial.commands if c.phase == "step")
    t = trial.t - step

    def left(_, y):
        return y + 0.02 * np.mean(y[(t > 60) & (t < 100)]) * (trial.t > vent + 1)

    slow = reduce([changed(run, left, left)])
    assert not s_of(slow).withheld
    assert not start_of(slow).withheld


def test_a_cell_that_drifts_is_withheld(run):
    """10 N of drift over the trial, of 1500 N, are 0.5 % of s per decade; without pressure the cell shows it."""
    one = s_of(reduce([changed(run, lambda t, y: y + 10 * t / 120)]))
    assert one.withheld
    assert "without pressure the cell reads +10" in one.note


def test_too_few_decades_give_no_slope(run):
    found = reduce([run], {"begin": 20.0})
    assert not found.estimates
    assert all("0.8 decades of time" in d.reason and "200 s" in d.reason for d in found.dropped)
    found = reduce([changed(run, lambda t, y: 0.01 * np.sin(1e3 * t))])
    assert "slack" in found.dropped[0].reason
    found = reduce([replace(run, trials=(replace(run.trials[0], status="failed"),))])
    assert found.dropped[0].reason == "the trial is failed"


def test_the_hold_before_is_in_the_budget_and_too_short_a_rest_is_seen(run):
    """After 120 s of 5 bar and 360 s of rest the next trial begins on what is left of it."""
    (second,) = (e for e in reduce([run]).estimates if e.symbol == "s" and e.at["contraction"] > 0.01)
    begin = second.trials[0]
    assert begin.endswith("/2")
    soon = replace(run.trials[1], index=1)
    shift = next(c.t for c in soon.commands if c.phase == "step") - 140.0
    first = run.trials[0]
    offset = soon.t[0] - first.t[-1] - 1.0
    commands = tuple(replace(c, t=c.t - offset) for c in soon.commands)
    near = replace(soon, t=soon.t - offset, commands=commands)
    assert shift > 0
    one = next(e for e in reduce([replace(run, trials=(first, near))]).estimates if e.at["contraction"] > 0.01)
    assert one.withheld
    assert "rest longer" in one.note


FOREIGN = """
schema: pmabench.map/1
name: holds of a logger
source: made for this test
kind: relaxation
file: {{delimiter: comma, header: first line}}
columns:
  t: {{is: time, unit: s}}
  p: {{is: pressure, unit: bar}}
  x: {{is: displacement, unit: mm, contraction: {{reading: rises, zero: 0 mm}}}}
  F: {{is: force, unit: N}}
  set: {{is: {set}}}
sampling: {{rate: [5 Hz, 2000 Hz], gap: 1 s}}
trials: {{by: command, smallest: 0.5 bar, lead: 2.5 s}}
specimen: {{type: D, serial: R-1}}
"""


@pytest.mark.parametrize("column", ["pressure_command, unit: bar", "ignore"])
def test_holds_of_another_program_relax_alike(run, tmp_path, column):
    """Plain columns of a log, with and without the commanded pressure."""
    rows = [np.column_stack([t.t, t.channels["pressure"] / 1e5, 1e3 * t.channels["displacement"], t.channels["force"],
                             t.channels["pressure_command"] / 1e5]) for t in run.trials]  # fmt: skip
    np.savetxt(tmp_path / "log.csv", np.vstack(rows), fmt="%.6g", delimiter=",", header="t,p,x,F,set", comments="")
    (tmp_path / "map.yaml").write_text(FOREIGN.format(set=column))
    (made,) = import_files([tmp_path / "log.csv"], tmp_path / "map.yaml", tmp_path / "runs")
    pairs = [[e for e in reduce([one]).estimates if e.symbol == "s"] for one in (run, open_run(made.path))]
    for own, other in zip(*pairs, strict=True):
        assert other.value == pytest.approx(own.value, abs=1e-4)
        assert other.at["contraction"] == pytest.approx(own.at["contraction"], abs=1e-4)


def test_a_hold_without_its_end_is_refused(run):
    trial = run.trials[0]
    rows = trial.t < next(c.t for c in trial.commands if c.phase == "vent")
    cut = replace(trial, t=trial.t[rows], channels={k: v[rows] for k, v in trial.channels.items()},
                  flags=trial.flags[rows], commands=tuple(c for c in trial.commands if c.phase != "vent"))  # fmt: skip
    assert "a drift of the cell looks like relaxation" in reduce([replace(run, trials=(cut,))]).dropped[0].reason


@pytest.mark.parametrize(("setting", "words"), [
    (("trial.hold", "5 s"), "a hold is 10 s to 100000 s"), (("trial.rest", "10 s"), "shorter than the hold"),
    (("trial.begin", "200 s"), "nothing of the hold is left"),
    (("sweep.matrix.contraction", "[-2 mm]"), "must be slack"),
])  # fmt: skip
def test_check_refuses_what_cannot_be(setting, words):
    with pytest.raises(InvalidFile, match=words):
        planned("relaxation", "mock-daerden-relaxing", "daerden-20-200", *SHORT, setting)


def test_one_trial_at_a_glance(run):
    numbers, doubts = one_trial(run, run.trials[0], None, Quick())
    assert [n.symbol for n in numbers] == ["s", "F_1"]
    assert numbers[0].value == pytest.approx(0.0205, abs=1e-3)
    assert doubts == []


@pytest.mark.parametrize(
    ("channel", "gain", "offset"), [("force", 0.01, 0.0), ("force", 0.0, 5.0), ("pressure", 0.0, 2e3)]
)
def test_a_channel_that_reads_wrong_by_its_uncertainty_moves_no_value_beyond_its_interval(run, channel, gain, offset):
    assert refuse_unexplained_moves(lambda runs: reduce(runs), run, channel, gain, offset) > 5


def sagging(pressures, lost=185.0, sag=0.005, seed=1):
    """s of holds of 300 s at `pressures` [Pa], of F = (1.08 N/kPa P - `lost`)(1 - 0.02 log10(t / 1 s)) and the truth.

    The pressure sags by `sag` per decade, straight over log t.
    """
    rng, trials = np.random.default_rng(seed), []
    t = np.arange(0.0, 310.0, 0.05)
    s = np.maximum(t - 5.0, 1e-3)
    held = (t > 5.0) & (t < 305.0)
    for i, P in enumerate(pressures):
        real = np.where(held, P * (1 - np.exp(-s / 0.2)) * (1 - sag * np.log10(1 + s)), 0.0)
        F = np.where(real > 0.5 * P, 1.08e-3 * real - lost, 0.0) * (1 - 0.02 * np.log10(np.maximum(s, 0.1)) * held)
        channels = {"pressure": real + rng.normal(0, 250.0, len(t)), "force": F + rng.normal(0, 0.25, len(t))}
        begin = 1e6 * i
        commands = (Command(begin + 5.0, "pressure", "set", P, 0.0, "step", {}),
                    Command(begin + 305.0, "pressure", "set", 0.0, P, "vent", {}))  # fmt: skip
        trials.append(TrialData("r", i, {"contraction": 0.02, "pressure": P}, 0, False, "finished", begin + t,
                                channels, np.zeros(len(t), dtype=np.uint16), commands, {}))  # fmt: skip
    found = reduce([as_run("relaxation", trials, 20.0, {"begin": 5.0})])
    return [e for e in found.estimates if e.symbol == "s"]


@pytest.mark.parametrize("sag", [0.002, 0.005])
@pytest.mark.parametrize("pressures", [(3e5,), (3e5, 4e5)])
def test_a_pressure_that_sags_is_worth_more_where_the_force_does_not_grow_in_proportion(pressures, sag):
    """Of a contracted muscle, at 57 % less than 1.08 N/kPa, half the correction was in the interval: 2.4 half widths."""
    for e in sagging(pressures, sag=sag):
        assert e.value is not None
        assert abs(e.value - 0.02) <= e.parts.combined
    assert len(sagging(pressures, sag=0.0)) == len(pressures)
    assert all(e.parts.combined < 0.0025 for e in sagging(pressures, sag=0.0))


def first(P, x):
    """F_1 of a muscle in closed form [N]."""
    return 1.2e-3 * P - 9e3 * x


def holds(of, places, seed=1):
    """A trial at each of `places` (contraction, pressure) in closed form, s = 2 %; `of` (trial, s after the step, F)."""
    rng, trials = np.random.default_rng(seed), []
    for x, P in places:
        t = 500.0 * len(trials) + np.arange(0.0, 130.0, 0.1)
        step = t[0] + 5.0
        held = (t > step) & (t < step + 120.0)
        F = np.where(held, law(np.maximum(t - step, 0.05), first(P, x)), 0.0)
        F = of(len(trials), t - step, F) + 0.1 * rng.standard_normal(len(t))
        channels = {"pressure": np.where(held, P, 0.0) + 50.0 * rng.standard_normal(len(t)), "force": F}
        commands = (
            Command(step, "pressure", "set", P, 0.0, "step", {}),
            Command(step + 120.0, "pressure", "set", 0.0, P, "vent", {}),
        )
        point = {"contraction": x, "pressure": P}
        flags = np.zeros(len(t), np.uint16)
        trials.append(TrialData("lab", len(trials), point, 0, False, "finished", t, channels, flags, commands, {}))
    known = {
        name: {"gain_uncertainty": 2e-3, "offset_uncertainty": o} for name, o in (("force", 1.0), ("pressure", 1500.0))
    }
    return as_run("relaxation", trials, 10.0, {"begin": 5.0}, known)


POINTS = [(x, P) for x in (0.0, 0.01, 0.02) for P in (3e5, 5e5)]


@pytest.mark.parametrize("gain", [0.06, -0.01])
@pytest.mark.parametrize("since", [8.0, 20.0, 50.0, 100.0])
def test_a_gain_that_changes_within_a_hold_is_in_every_value_and_said(gain, since):
    """With one trial a point the forces after it were 8.8 half widths off: F_1 jumps, and the pressure does not."""
    found = reduce([holds(lambda n, t, F: F * np.where((n > 2) | ((n == 2) & (t >= since)), 1 + gain, 1.0), POINTS)])
    (text,) = [f.text for f in found.findings if "the force jumps" in f.text]
    assert text.startswith(f"{since:.0f} s after the step of trial 3")
    known = [e for e in found.estimates if e.symbol in ("s", "F_1") and e.value is not None]
    assert all(e.withheld for e in found.estimates if e.symbol == "F_1") == (gain == 0.06)
    for e in known:
        truth = 0.02 if e.symbol == "s" else first(e.at["pressure"], e.at["contraction"])
        assert abs(e.value - truth) <= e.parts.combined, (e.symbol, e.at, e.value, e.parts)


def test_a_gain_that_changes_between_two_trials_makes_another_muscle_and_that_it_would_not_show_is_said():
    """g(n) F_n for a gain of each trial is the record of a muscle with these forces: only a point done again differs."""
    found, said = reduce([holds(lambda n, _t, F: F * np.where(n > 2, 1.06, 1.0), POINTS)]), "would have, and nothing"
    assert len([f for f in found.findings if said in f.text]) == 1
    repeated = reduce([holds(lambda _n, _t, F: F, [*POINTS, POINTS[0]])])
    assert not [f for f in repeated.findings if f.level == "doubt"]


@pytest.mark.parametrize(("rate", "s"), [(1.0, 0.06), (1.0, 0.08), (2.0, 0.08), (0.2, 0.03), (10.0, 0.05)])
def test_a_slow_log_of_a_steep_course_has_no_jump(rate, s):
    """At 1 Hz the course itself was a "jump" of 0.5 % at 19 s."""
    t = np.arange(1.0 if rate >= 1 else 5.0, 600.0, 1 / rate)
    y = 100 * (1 - s * np.log10(t)) + 0.01 * np.random.default_rng(0).normal(size=len(t))
    assert Relaxing(t, y).jump == (0.0, 0.0)
    size, since = Relaxing(t, y * np.where(t > 100, 1.02, 1.0)).jump
    assert size == pytest.approx(0.02 * 100 * (1 - 2 * s), rel=0.15)
    assert since == pytest.approx(100.0, abs=2 / rate)


def test_what_the_pressure_or_slow_noise_makes_of_the_force_is_no_jump():
    """A blow of 0.3 s and a noise with a memory of 10 s, larger than the white one."""
    rng = np.random.default_rng(7)

    def slow(_n, t, F):
        return (
            F + lfilter([0.14], [1, -0.99], rng.standard_normal(len(t))) * 3 + np.where(abs(t - 40) < 0.11, 30.0, 0.0)
        )

    assert not [f for f in reduce([holds(slow, POINTS)]).findings if "jumps" in f.text]


GONE = {1.0: 0.1168, 10.0: 0.0302, 100.0: 0.0382, 1000.0: 0.0196}
"""Shares that follow a straight line over log t within 0.03 % from 5 s on."""


def exponential(t, gone, F=1000.0):
    """F [g_0 + sum g exp(-t / T)], with F the force right after the step [N]."""
    return F * (1 - sum(g * (1 - np.exp(-t / T)) for T, g in gone.items()))


@pytest.mark.parametrize(("gone", "most"), [(GONE, 0.02), ({10.0: 0.04}, 0.01), ({10.0: 0.03, 100.0: 0.03}, 0.01)])
def test_intervals_of_the_exponentials_hold_them_under_noise(gone, most):
    """0.3 N of 1000 N, 300 s: sizes at 10 and 100 s, though 1 and 1000 s, which are not shown, take a part of them.

    A muscle that is exponential had 51 % for 4 % at 10 s, one that is nearly straight 0.3 % for an error of 1 %.
    """
    t, rng = np.arange(5.0, 300.0, 0.05), np.random.default_rng(3)
    off, widths = [], []
    for _ in range(40):
        sizes, _, halves = Relaxing(t, exponential(t, gone) + rng.normal(0, 0.3, len(t))).prony
        off += [abs(sizes[i] - 1000 * gone.get(T, 0.0)) / halves[i] for i, T in ((2, 10.0), (3, 100.0))]
        widths.append(halves[2] / 1000 / 0.03)
    assert np.mean(np.array(off) <= 1) >= 0.93
    assert max(off) < 1.5
    assert np.median(widths) < most


def at_1_s(gone):
    """F_1 [N]: the straight line over the decades from 5 to 120 s, through 60 places."""
    places = 5 * 24 ** (np.arange(60) / 59)
    return float(np.polyfit(np.log10(places), exponential(places, gone), 1)[1])


def shares(of, gone=GONE, P=5e5):
    """g of one hold of 120 s whose force is exponential, and what they are; `of` (s after the step, F)."""
    found = reduce([holds(lambda _n, t, F: of(t, np.where(F > 0, exponential(t, gone), 0.0)), [(0.01, P)])])
    start = at_1_s(gone)
    return [(e, 1000 * gone.get(float(e.coordinate.split()[0]), 0.0) / start) for e in found.estimates
            if e.symbol == "g" and (e.value is not None or e.withheld)]  # fmt: skip


def test_shares_of_a_sound_hold_are_given_and_right():
    found = shares(lambda _t, F: F)
    assert [e.coordinate for e, _ in found] == ["10 s", "100 s"]
    for e, truth in found:
        assert abs(e.value - truth) <= e.parts.combined < 0.2 * truth


@pytest.mark.parametrize("fault", [
    lambda t, F: F + 5 * np.clip(t / 120, 0, 1), lambda t, F: F - 3 * (1 - np.exp(-np.maximum(t, 0) / 10)),
    lambda t, F: F * np.where(t > 50, 1.01, 1.0), lambda t, F: np.where(F > 0, F + 20, 20),
])  # fmt: skip
def test_what_makes_the_relaxation_doubtful_reaches_the_shares(fault):
    """A zero that drifts, or is off, and a gain that jumps: as of s, each share holds them or is withheld."""
    for e, truth in shares(fault):
        assert e.withheld or abs(e.value - truth) <= e.parts.combined, (e.coordinate, e.value, truth, e.parts)


def test_a_pressure_that_creeps_is_in_the_shares():
    """0.5 % per decade that the gauge reads and the muscle does not have were 14 and 53 half widths."""
    run = holds(lambda _n, t, F: np.where(F > 0, exponential(t, GONE), 0.0), [(0.01, 5e5)])
    crept = reduce([changed(run, P=lambda t, P: P * (1 + 0.005 * np.log10(1 + t)))])
    for e in (e for e in crept.estimates if e.symbol == "g" and e.value is not None):
        truth = 1000 * GONE[float(e.coordinate.split()[0])] / at_1_s(GONE)
        assert abs(e.value - truth) <= e.parts.combined


def vented(after, rest, drift=lambda t: 0 * t):
    """One hold of 300 s of 1000 N, s = 3 %, and its `rest` [s], in which the cell reads `after` (s after the vent).

    `drift` of the cell (s after the step) is added throughout.
    """
    t, rng = np.arange(0.0, 305.0 + rest, 0.1), np.random.default_rng(5)
    held = (t > 5.0) & (t < 305.0)
    F = np.where(held, law(np.maximum(t - 5.0, 0.05), 1000.0, 0.03), 0.0) + drift(np.maximum(t - 5.0, 0.0))
    F = F + np.where(t >= 305.0, after(np.maximum(t - 305.0, 0.05)), 0.0) + 0.1 * rng.standard_normal(len(t))
    channels = {"pressure": np.where(held, 5e5, 0.0) + 50.0 * rng.standard_normal(len(t)), "force": F}
    commands = (Command(5.0, "pressure", "set", 5e5, 0.0, "step", {}), Command(305.0, "pressure", "set", 0.0, 5e5, "vent", {}))  # fmt: skip
    point = {"contraction": 0.0, "pressure": 5e5}
    trial = TrialData("lab", 0, point, 0, False, "finished", t, channels, np.zeros(len(t), np.uint16), commands, {})
    known = {"force": {"gain_uncertainty": 2e-3, "offset_uncertainty": 0.4}}
    return reduce([as_run("relaxation", [trial], 10.0, {"begin": 5.0}, known)])


def recovers(t):
    """The same step back, 300 s later, of a muscle that can push: -s F_1 log10((t + 300 s) / t)."""
    return -30.0 * np.log10((t + 300.0) / t)


@pytest.mark.parametrize("rest", [5.0, 60.0, 900.0])
@pytest.mark.parametrize("share", [0.0, 0.8, 1.0, 1.2])
def test_what_the_muscle_itself_recovers_is_no_drift_of_the_cell(rest, share):
    """3.7 N after 900 s, 53 N after 5 s; a slack muscle, of a share of 0, reads nothing."""
    found = vented(lambda t: share * recovers(t), rest)
    one = s_of(found)
    assert abs(one.value - 0.03) <= one.parts.combined < 0.003
    assert abs(start_of(found).value - 1000) <= start_of(found).parts.combined


@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize("drift", [-8.0, 8.0])
def test_a_drift_beyond_the_recovery_is_the_cells(share, drift):
    one = s_of(vented(lambda t: share * recovers(t) + drift, 900.0))
    assert one.withheld
    reads = re.search(r"without pressure the cell reads ([-+][\d.]+) N", one.note)
    assert float(reads[1]) == pytest.approx(drift, rel=0.3), "a hold that is slightly bent recovers by less at the end"


@pytest.mark.parametrize("rest", [5.0, 60.0, 900.0])
@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize("drift", [
    lambda t: 2 * t / 300, lambda t: -2 * t / 300, lambda t: 0.7 * np.log10(1 + t), lambda t: -0.7 * np.log10(1 + t),
    lambda t: 2 * (1 - np.exp(-t / 30)) - 2 * (t > 300) * (1 - np.exp(-np.maximum(t - 300, 0) / 30)),
])  # fmt: skip
def test_a_small_drift_of_the_cell_is_in_the_interval_with_and_without_a_recovery(drift, share, rest):
    """2 N of 1000, where the recovery reads 53 N after 5 s and 3.7 N after 900 s."""
    one = s_of(vented(lambda t: share * recovers(t), rest, drift))
    assert one.withheld or abs(one.value - 0.03) <= one.parts.combined


@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize("drift", [-5.0, 5.0])
def test_a_cell_that_warms_in_the_hold_and_is_cool_again_at_the_end_is_withheld(share, drift):
    """Its zero follows with 60 s; with a muscle that pushes, s was 2.3 half widths off where the end alone counted."""

    def warm(t):
        return share * recovers(t) + drift * np.exp(-t / 60)

    assert s_of(vented(warm, 900.0)).withheld


def test_a_slack_muscle_whose_cell_drifts_as_far_as_another_one_recovers_is_withheld():
    """-3.75 N at the end of 900 s, with or without a course towards it."""
    for after in (lambda t: -3.75 + 0 * t, lambda t: -3.75 * (0.5 + 0.5 * t / 900)):
        assert s_of(vented(after, 900.0)).withheld


@pytest.mark.parametrize("zero", [-15.0, 8.0, 50.0])
def test_a_cell_whose_zero_is_off_before_the_step_is_in_the_force(zero):
    """F_1 of 1000 N + zero; what is declared is 0.4 N."""

    def off(_n, t, F):
        return np.where(F > 0, law(np.maximum(t, 0.05), 1000.0, 0.03), 0.0) + zero

    found = reduce([holds(off, [(0.0, 5e5)])])
    assert start_of(found).withheld == (abs(zero) > 20)
    for e, truth in ((s_of(found), 0.03), (start_of(found), 1000.0)):
        assert e.withheld or abs(e.value - truth) <= e.parts.combined
    assert "before the step the cell reads +50 N" in start_of(found).note or zero < 50


@pytest.mark.parametrize("way", [0.0, 2e-5, 2e-4, 5e-4])
def test_a_displacement_that_yields_during_the_hold_is_no_relaxation(way):
    """`way` [m] per decade at 9 N/mm, of 600 N."""
    run = holds(lambda _n, t, F: F - np.where(F > 0, 9e3 * way * np.log10(1 + np.maximum(t, 0)), 0.0), [(0.0, 5e5)])
    trial = run.trials[0]
    since = np.maximum(trial.t - trial.commands[0].t, 0.0)
    x = way * np.log10(1 + since) * (since < 120) + np.random.default_rng(2).normal(0, 5e-6, len(since))
    run = replace(run, trials=(replace(trial, channels={**trial.channels, "displacement": x}),))
    found = reduce([run])
    one = s_of(found)
    assert one.withheld == (way > 1e-4)
    assert one.withheld or abs(one.value - 0.02) <= one.parts.combined
    assert "the displacement changes" in one.note or not one.withheld
    assert way or one.parts.combined < 2e-4
