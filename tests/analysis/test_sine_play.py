"""Sines read by a displacement sensor with play: x = 0.3 mm/kPa times the pressure, one lag of 20 ms later."""

import numpy as np
import pytest

from pmabench.kinds.reduce import reduce_runs
from pmabench.store.records import TrialData
from tests.analysis.judged_forms import as_run

RATE, GAIN, LAG, AMPLITUDE = 250.0, 0.3e-6, 0.02, 50e3
FREQUENCIES = (0.25, 0.5, 1.0)


def played(x, play):
    """What a sensor shows that follows once it is moved by more than half of its play."""
    found, now = np.empty(len(x)), x[0]
    for i, one in enumerate(x):
        found[i] = now = min(max(now, one - play / 2), one + play / 2)
    return found


def found(play, bent=0.0):
    """Estimates by symbol and frequency; the displacement bends by the share `bent` of its swing, by the third power."""
    rng, trials, begin = np.random.default_rng(3), [], 0.0
    for number, f in enumerate(FREQUENCIES):
        w, t = 2 * np.pi * f, np.arange(round(8 / f * RATE)) / RATE
        x = GAIN * AMPLITUDE * np.sin(w * t - np.arctan(w * LAG)) / np.hypot(1, w * LAG)
        x = x * (1 - bent * (x / (GAIN * AMPLITUDE)) ** 2)
        channels = {"pressure": 300e3 + AMPLITUDE * np.sin(w * t) + rng.normal(0, 300, len(t)),
                    "displacement": played(0.09 + x, play) + rng.normal(0, 1e-5, len(t))}  # fmt: skip
        flags = np.zeros(len(t), dtype=np.uint16)
        trials.append(
            TrialData("a", number, {"frequency": f}, 0, False, "finished", begin + t, channels, flags, (), {})
        )
        begin += t[-1] + 5.0
    known = {"pressure": {"offset_uncertainty": 750.0, "gain_uncertainty": 0.005},
             "displacement": {"offset_uncertainty": 5e-5, "gain_uncertainty": 0.003}}  # fmt: skip
    (analysis,) = reduce_runs([as_run("recorded-sine", trials, RATE, {}, known)])
    return {(e.symbol, e.at["frequency"]): e for e in analysis.estimates if "frequency" in e.at}


def truth(symbol, f):
    turn = 1j * 2 * np.pi * f * LAG
    x = GAIN * AMPLITUDE / abs(1 + turn)
    return {"x": x, "P/x": AMPLITUDE / x, "phi_x": -np.angle(1 + turn)}[symbol]


@pytest.mark.parametrize("play", [2e-4, 1e-3, 2e-3, 4e-3])
def test_a_play_of_the_sensor_is_in_amplitude_gain_and_phase(play):
    """2 mm of 30 mm: x was 14 half widths off, P/x 7, and only H withheld."""
    values = found(play)
    for symbol in ("x", "P/x", "phi_x"):
        for f in FREQUENCIES:
            e = values[symbol, f]
            assert not e.withheld, (symbol, f)
            assert abs(e.value - truth(symbol, f)) < e.parts.combined, (symbol, f)


@pytest.mark.parametrize("bent", [0.0, 0.02])
def test_without_play_nothing_is_added(bent):
    """A bend is no play: its third harmonic is in phase."""
    for e in found(0.0, bent).values():
        assert not any("play" in line.name for line in e.budget)
