"""Channels that are read seldom and held in between, sensors with hysteresis, frequencies that lie apart: closed forms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pmabench.analysis.shared.samples import fresh
from pmabench.kinds.recorded_sine import reduction as recorded_sine
from pmabench.store.analyses.results import Analysis, Estimate
from pmabench.store.records import Array, RunData, TrialData
from tests.analysis.judged_forms import as_run


def held(t: Array, y: Array, rate: float, jitter: float = 0.0, seed: int = 1) -> Array:
    """`y` (n,) as it is where it is asked `rate` times a second, up to half of `jitter` periods sooner or later."""
    rng = np.random.default_rng([11, seed])
    asked = np.arange(t[0] - rng.random() / rate, t[-1] + 1 / rate, 1 / rate)
    asked = np.sort(asked + jitter / rate * rng.uniform(-0.5, 0.5, len(asked)))
    last = asked[np.clip(np.searchsorted(asked, t, side="right") - 1, 0, None)]
    return np.asarray(y[np.clip(np.searchsorted(t, np.maximum(last, t[0])), 0, len(y) - 1)])


def played(y: Array, half: float) -> Array:
    """What a sensor with hysteresis of +- `half` reads of `y` (n,)."""
    at = np.empty_like(y)
    now = y[0]
    for row, value in enumerate(y):
        now = min(max(now, value - half), value + half)
        at[row] = now
    return at


def trial(
    t: Array, channels: Mapping[str, Array], point: Mapping[str, float], number: int = 0, **more: object
) -> TrialData:
    flags = np.zeros(len(t), dtype=np.uint16)
    facts = {"commands": (), "found": {}, **more}
    return TrialData("judged", number, dict(point), number, False, "finished", t, dict(channels), flags, **facts)  # type: ignore[arg-type]


@pytest.mark.parametrize("jitter", [0.0, 0.8])
def test_a_device_that_answers_sooner_or_later_is_polled_as_well(jitter: float) -> None:
    t = np.arange(0, 20, 0.005)
    y = np.sin(2 * np.pi * 0.3 * t) + 1e-3 * np.random.default_rng(3).standard_normal(len(t))
    new = fresh(held(t, y, 10.0, jitter))
    assert new.sum() == pytest.approx(200, abs=3)
    assert fresh(y).all()


def test_a_reading_that_sticks_behind_its_noise_is_not_polled() -> None:
    """A sensor with hysteresis moves with every sample now and then, and at other times not at all."""
    t = np.arange(0, 20, 0.005)
    for size in (2e-3, 5e-3, 0.02):
        y = np.sin(2 * np.pi * 0.05 * t) + 1e-3 * np.random.default_rng(3).standard_normal(len(t))
        assert fresh(played(y, size)).all()


# -- sines of pressure --------------------------------------------------------------------------------------------

SINES = {"P": 46e3, "x": 4e-3, "phi_x": -0.2, "phi_P": -0.3, "P/x": 46e3 / 4e-3, "H": 8e-3 * np.sin(0.2)}


def on_time(run: RunData) -> RunData:
    """A run whose pressure is known to be no older than its stamps."""
    return replace(run, manifest={"imported": {"late_by": {"pressure": [0.0, 0.0]}}})


def sines(
    frequency: float, faults: Mapping[str, Callable[[Array], Array]] | None = None,
    known: Mapping[str, Mapping[str, Any]] | None = None,
) -> Analysis:  # fmt: skip
    """Two trials of 20 cycles at 200 Hz; `faults` are what sensors make of what there is."""
    trials, t = [], np.arange(0, 20 / frequency, 0.005)
    for number in range(2):
        rng = np.random.default_rng([5, number])
        w = 2 * np.pi * frequency * t
        channels = {
            "pressure": 250e3 + 46e3 * np.sin(w - 0.3) + 300 * rng.standard_normal(len(t)),
            "displacement": 0.02 + 4e-3 * np.sin(w - 0.5) + 4e-6 * rng.standard_normal(len(t)),
            "pressure_command": 250e3 + 50e3 * np.sin(w),
        }
        channels |= {name: fault(channels[name]) for name, fault in (faults or {}).items()}
        trials.append(trial(100 * number + t, channels, {"frequency": frequency}, number))
    return recorded_sine.reduce([on_time(as_run("recorded-sine", trials, 200.0, {}, known))])


@pytest.mark.parametrize("polled", ["pressure", "displacement"])
@pytest.mark.parametrize(("frequency", "rate", "jitter"), [(0.3, 4.0, 0.0), (0.3, 10.0, 0.8), (1.0, 25.0, 0.0)])
def test_sines_are_fitted_to_what_a_polled_channel_reads_anew(
    polled: str, frequency: float, rate: float, jitter: float
) -> None:
    t = np.arange(0, 20 / frequency, 0.005)
    found = sines(frequency, {polled: lambda y: held(t, y, rate, jitter)})
    assert found.estimates
    for e in found.estimates:
        if e.value is not None and e.symbol in SINES:
            assert e.parts.combined is not None
            assert abs(e.value - SINES[e.symbol]) < 1.3 * e.parts.combined, e.symbol


@pytest.mark.parametrize("frequency", [1.0, 2.0])
def test_each_of_two_polled_channels_is_fitted_where_it_is_new(frequency: float) -> None:
    """Both are new in the same sample 8 or 3 times a cycle only, by chance: nothing was given."""
    t = np.arange(0, 20 / frequency, 0.005)
    faults = {"pressure": 50.0, "displacement": 30.0}
    found = sines(frequency, {n: lambda y, n=n: held(t, y, faults[n], 0.4, len(n)) for n in faults})  # type: ignore[misc]
    right = {e.symbol: e for e in found.estimates if e.symbol in SINES}
    assert set(right) == set(SINES)
    for symbol, e in right.items():
        assert e.value is not None, symbol
        assert e.parts.combined is not None
        assert abs(e.value - SINES[symbol]) < 1.3 * e.parts.combined, symbol
        assert e.parts.combined < (0.02 if symbol[:3] != "phi" else 0.6) * abs(SINES[symbol]) or symbol == "H"


def test_a_channel_that_is_new_too_few_times_a_cycle_gives_no_sine() -> None:
    t = np.arange(0, 20, 0.005)
    found = sines(1.0, {"displacement": lambda y: held(t, y, 4.0)})
    assert not found.estimates
    assert all("displacement is new 4.1 times a cycle, and held in between" in one.reason for one in found.dropped)


@pytest.mark.parametrize(("half", "channel"), [(1500.0, "pressure"), (50e-6, "displacement")])
def test_hysteresis_of_a_sensor_up_to_its_uncertainty_is_in_the_phases(half: float, channel: str) -> None:
    """It turned them by 3 to 4 half widths; where the loop is an ellipse there is none, and nothing is added."""
    known = {"pressure": {"offset_uncertainty": 1500.0}, "displacement": {"offset_uncertainty": 50e-6}}
    for faulty in (True, False):
        wrong = {channel: lambda y: played(y, half)} if faulty else {}
        found = {e.symbol: e for e in sines(0.3, faults=wrong, known=known).estimates}
        plain = {e.symbol: e for e in sines(0.3).estimates}
        for symbol in ("phi_x", "phi_P"):
            value, most = found[symbol].value, found[symbol].parts.combined
            assert value is not None
            assert most is not None
            assert abs(value - SINES[symbol]) < most
            if not faulty:
                assert most < 1.1 * (plain[symbol].parts.combined or 0.0)


def swept(gain: Callable[[float], complex], frequencies: Sequence[float]) -> Estimate:
    """f_b of two sines of the command at each frequency."""
    trials = []
    for number, f in enumerate(np.repeat(frequencies, 2).tolist()):
        t, rng = np.arange(0, max(8.0, 3 * f) / f, 0.005), np.random.default_rng([2, number])
        P = 250e3 + 50e3 * np.sin(2 * np.pi * f * t)
        x = 0.02 + 4e-3 * np.imag(gain(f) * np.exp(2j * np.pi * f * t)) + 4e-6 * rng.standard_normal(len(t))
        noisy = P + 300 * rng.standard_normal(len(t))
        channels = {"pressure": noisy, "displacement": x, "pressure_command": P}
        trials.append(trial(100 * number + t, channels, {"frequency": f}, number % 2))
    known = {name: {"sensor_lag": 1e-5} for name in ("pressure", "displacement")}
    run = as_run("recorded-sine", trials, 200.0, {}, known)
    return next(e for e in recorded_sine.reduce([on_time(run)]).estimates if e.symbol == "f_b")


@pytest.mark.parametrize("frequencies", [(0.2, 1.0, 5.0), (0.2, 2.0, 8.0), (0.2, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)])
def test_a_bandwidth_between_frequencies_that_lie_apart_holds_a_plant_of_second_order(
    frequencies: tuple[float, ...],
) -> None:
    """|G| = 1/sqrt(2) |G(slowest)|, solved on a fine grid: the interval was 0.63 Hz about 2.51, and it is 4.36 Hz."""
    plants: tuple[Callable[[float], complex], ...] = (
        lambda f: 1 / (1 - (f / 3) ** 2 + 0.2j * f),
        lambda f: np.exp(-0.25j * f) / (1 + 0.5j * f) / (1 + 0.25j * f),
    )
    for plant in plants:
        grid = np.geomspace(frequencies[0], 20, 20001)
        true = float(grid[np.argmax(np.abs([plant(f) for f in grid]) < abs(plant(frequencies[0])) / np.sqrt(2))])
        found = swept(plant, frequencies)
        assert found.value is not None
        assert found.parts.combined is not None
        assert abs(found.value - true) < found.parts.combined
        if len(frequencies) == 8:
            assert found.parts.combined < 0.06 * true
