"""The contractors of paper 2: free lengths of the table, the dead band, force; and curves of many pieces."""

import numpy as np
import pytest

from pmabench.model.curve import MANY, Curve
from pmabench.model.driven import Actuator
from pmabench.model.library import MODELS
from pmabench.model.overrides import Overrides
from pmabench.model.presets import CONTRACTORS, preset
from pmabench.model.regulator import constant, ramp

CONTRACTION = {
    "contractor-15": (26.8, 32.2, 34.1, 35.9),
    "contractor-20": (18.4, 26.3, 29.0, 31.3),
    "contractor-25": (11.9, 21.7, 25.1, 28.0),
    "contractor-30": (8.5, 18.9, 22.7, 26.1),
    "contractor-40": (11.5, 19.6, 23.1, 26.4),
}
"""[%] at 1, 2, 3, 5 bar, computed from the printed coefficients with the mended exponent."""


@pytest.mark.parametrize("plant", CONTRACTORS)
def test_a_free_one_comes_to_the_length_of_the_table(plant):
    made = preset(plant, "ideal").free()
    for bar, percent in zip((1, 2, 3, 5), CONTRACTION[plant], strict=True):
        made.command(constant(made.time, bar * 1e5))
        made.advance(made.time + 10.0)
        assert 100 * made.x / CONTRACTORS[plant] == pytest.approx(percent, abs=0.06)


def test_there_is_no_force_up_to_045_bar_and_then_a_line_at_no_contraction():
    made = preset("contractor-30", "ideal").driven(Actuator(force=5000.0))
    made.command(ramp(0.0, 0.0, 2e5, 1e4))
    motion = made.advance(21.0, 0.04 + np.arange(1, 2001) / 100)
    dead = motion.P < 0.45e5
    assert (motion.F[dead] == 0).all()
    np.testing.assert_allclose(motion.F[~dead], np.pi * 1e-4 * (motion.P[~dead] - 0.45e5) * (13.797 - 5.599), rtol=1e-3)


def test_the_force_is_that_of_the_library():
    made = preset("contractor-20", "ideal").driven(Actuator(force=5000.0))
    made.command(constant(0.0, 4e5))
    made.move(ramp(0.0, 0.0, 71.8e-3, 10e-3))
    motion = made.advance(8.0, np.arange(100, 731) / 100)
    expected = MODELS["corrected-force"].evaluate({"pressure": 4e5, "contraction": motion.x / 0.2})["force"]
    np.testing.assert_allclose(motion.F, expected, atol=1e-9)
    assert motion.F[-1] == 0


@pytest.mark.parametrize("changes", [{"F_c": 1.0}, {"hysteresis": 1.0}, {"conductance_fill": 1e-7}])
def test_what_it_has_no_use_for_is_refused(changes):
    with pytest.raises(ValueError, match="contractor-30"):
        preset("contractor-30", "ideal", Overrides(**changes))


@pytest.mark.parametrize("count", [MANY - 1, MANY, MANY + 1, 40])
def test_a_curve_is_the_same_however_many_pieces_it_has(count):
    rng = np.random.default_rng(count)
    pieces = tuple(tuple(rng.normal(size=1 + i % 4)) for i in range(count))
    breaks = tuple(range(1, count))
    curve, P = Curve(pieces, breaks), np.sort(np.concatenate((rng.uniform(-1, count + 1, 200), breaks)))
    expected = [np.polyval(pieces[int(np.searchsorted(breaks, p, side="right"))], p) for p in P]
    np.testing.assert_allclose(curve.values(P), expected, rtol=1e-12)
    np.testing.assert_allclose([curve.function()(p) for p in P], expected, rtol=1e-12)
    np.testing.assert_allclose(curve.values(P.reshape(-1, 1)).ravel(), expected, rtol=1e-12)
