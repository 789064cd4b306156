"""The hysteresis that knows no rate against the library's path, and against itself cut into stretches."""

import copy
import itertools
import math

import numpy as np
import pytest

from pmabench.model.hysteresis import Branch, Hysteresis, turns
from pmabench.model.regulator import Regulated, Regulator, Trace, Wave, constant, lagged, ramp, sine
from tests.model.hysteresis_path import hysteresis_path

LOOP = Hysteresis(30.0, 1.2e-3)


def path(*commands, lag=0.0):
    """A place that follows commands one after another, each given when the one before has been taken in."""
    made = Regulated(Regulator(dead_time=0.0, lag=lag), 0.0, 0.0)
    for waves in commands:
        made.command(waves)
    return made


COMMANDS = {
    "ramps": (ramp(0.0, 0.0, 20e-3, 0.05), ramp(1.0, 20e-3, -4e-3, 0.05), constant(2.0, 5e-3)),
    "sines": (sine(0.5, 0.0, 3e-3, 3.0, 7), sine(4.0, 0.0, 1e-3, 0.37, 2)),
    "both": (ramp(0.0, 0.0, 17e-3, 0.1), sine(0.7, 17e-3, 9e-3, 2.0, 6), constant(4.1, 20e-3)),
}


@pytest.mark.parametrize("lag", [0.0, 0.005, 0.3])
@pytest.mark.parametrize("name", COMMANDS)
def test_it_is_the_integral_along_the_path(name, lag):
    """The library's path of 40,000 points knows no turn; it misses each by at most one step, worth 0.2 N."""
    made, t = path(*COMMANDS[name], lag=lag), np.linspace(0.0, 6.0, 40_001)
    x = copy.copy(made).values(t)[0]
    expected = hysteresis_path(x, LOOP.height, LOOP.width)
    F = Branch(LOOP, 0.0, 0.0).along(made, t, x)
    assert np.abs(F).max() > 15
    np.testing.assert_allclose(F, expected, atol=0.25)


@pytest.mark.parametrize("lag", [0.0, 0.005, 0.3])
@pytest.mark.parametrize("name", COMMANDS)
def test_samples_are_the_same_however_the_time_is_cut(name, lag):
    t = np.arange(1, 3001) / 500
    whole_path = path(*COMMANDS[name], lag=lag)
    whole = Branch(LOOP, 0.0, 0.0).along(whole_path, t, copy.copy(whole_path).values(t)[0])
    rng = np.random.default_rng(1)
    cuts = np.unique(np.concatenate(([0, 3000], rng.integers(0, 3000, 400))))
    made, branch, parts = path(*COMMANDS[name], lag=lag), Branch(LOOP, 0.0, 0.0), []
    for first, last in itertools.pairwise(cuts):
        before = copy.copy(made)
        parts.append(branch.along(before, t[first:last], made.values(t[first:last])[0]))
    np.testing.assert_allclose(np.concatenate(parts), whole, atol=1e-9)


def test_two_samples_see_all_that_lay_between():
    """From rest 30 periods later: the loop is steady, though nothing was looked at inside."""
    made = path(sine(0.0, 0.0, 3e-3, 1.0, 30))
    t = np.array([0.0, 30.0])
    F = Branch(LOOP, 0.0, 0.0).along(made, t, copy.copy(made).values(t)[0])
    turn = 30.0 * math.tanh(6e-3 / (2 * 1.2e-3))
    assert F[1] == pytest.approx(-30.0 + (turn + 30.0) * math.exp(-3e-3 / 1.2e-3), abs=1e-6)


@pytest.mark.parametrize(
    ("wave", "value", "lag"),
    [
        (Wave(0.0, 0.0, amplitude=5.0, omega=9.0, phase=0.4), 0.0, 0.0),
        (Wave(0.0, 0.0, amplitude=5.0, omega=9.0, phase=0.4), -3.0, 0.05),
        (Wave(0.0, 1.0, slope=2.0), 4.0, 0.3),
        (Wave(0.0, 1.0, slope=2.0), 0.0, 0.3),
        (Wave(0.0, 1.0), 4.0, 0.3),
    ],
)
def test_turns_are_where_the_rate_changes_its_sign(wave, value, lag):
    trace = lagged(wave, 0.0, value, lag)
    end = 8 * 2 * math.pi / 9.0
    fine = np.linspace(0.0, end, 400_001)
    rising = trace.rates(fine) > 0
    expected = fine[1:][rising[1:] != rising[:-1]]
    found = turns(trace, 0.0, end)
    assert len(found) == len(expected)
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_a_constant_never_turns():
    assert turns(Trace(0.0, 3.0), 0.0, math.inf).size == 0


def test_an_impossible_hysteresis_is_refused():
    with pytest.raises(ValueError, match="width"):
        Hysteresis(30.0, 0.0)
