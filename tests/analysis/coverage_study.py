"""Simulated campaigns of 24 trials of 8 s whose sensors err within their calibration, and how often intervals hold.

The bench and plant `serres2009`; each campaign draws the offset of every channel anew, normal with half its expanded
uncertainty (k = 2), besides noise and counts.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from math import ceil

import numpy as np
from scipy.stats import beta

from pmabench.kinds.contraction_relaxation.reduction import estimates_of, pool
from pmabench.kinds.contraction_relaxation.segments import gather
from pmabench.model.plant import Plant
from pmabench.model.regulator import constant
from pmabench.store.analyses.results import Estimate
from pmabench.store.records import Array, Command, RunData, TrialData
from tests.analysis.simulate import LOADS, RATE, UNITS, _run, rig
from tests.analysis.test_contraction import SERRES

BENCH = rig("serres2009", uncertainty=True)
CELLS = [(load, 1e3 * P) for load in LOADS[:6:2] for P in range(200, 551, 50)]
"""24 of (load [N], pressure [Pa]); up to 550 kPa, so that 500 kPa is relaxed through."""
WATCHED = (200e3, 350e3, 500e3)
CHANNELS = ("pressure", "displacement", "force")
SAMPLES = round(8.0 * RATE)
Row = dict[tuple[str, float], tuple[float, float]]


def commands(pressure: float) -> list[tuple[float, float, float, str]]:
    """Time [s], value [Pa], before [Pa], phase: one step up, down by about 100 kPa, and vented within 8 s."""
    steps = ceil(pressure / 100e3)
    values = [pressure, *(pressure - 100e3 * i for i in range(1, steps)), 0.0]
    times = [0.2, *(2.6 + 5.2 / steps * i for i in range(steps))]
    phases = ["contract", *["relax"] * (steps - 1), "vent"]
    return list(zip(times, values, [0.0, *values], phases, strict=False))


@lru_cache(maxsize=64)
def motion(load: float, pressure: float) -> tuple[Array, dict[str, Array]]:
    """What happens in one trial, without noise."""
    plant = Plant(BENCH.muscle, BENCH.setup.regulator, force=load, mass=BENCH.mass(load))
    plant.command(tuple(wave for at, value, _, _ in commands(pressure) for wave in constant(at, value)))
    t = np.arange(SAMPLES) / RATE
    moved = plant.advance(float(t[-1]), t)
    return t, {"pressure": moved.P, "displacement": moved.x, "force": moved.F, "pressure_command": moved.P_set}


def campaign(
    seed: int,
    wrong: Sequence[str] = CHANNELS,
    noise: float | Mapping[str, float] = 1.0,
    counts: Mapping[str, float] | None = None,
) -> RunData:
    """One campaign; `wrong` names the channels whose sensors err, `noise` scales the noise of all, or of each by name.

    `counts` [SI] in place of those of the mock bench, by name; where they lie is then drawn, too.
    """
    chance = np.random.default_rng(seed)
    off = {name: 0.5 * UNITS[name][3] * chance.standard_normal() for name in CHANNELS}
    trials = []
    for load, pressure in CELLS:
        t, clean = motion(load, pressure)
        channels = {}
        for name, values in clean.items():
            count = (counts or {}).get(name, UNITS[name][2])
            scale = noise if isinstance(noise, float) else noise.get(name, 0.0)
            shaken = scale * getattr(BENCH.setup.noise, name, 0.0) * chance.standard_normal(len(values))
            read = values - (off.get(name, 0.0) if name in wrong else 0.0) + shaken
            lies = count * chance.uniform(-0.5, 0.5) if name in (counts or {}) else 0.0
            channels[name] = np.rint((read - lies) / count) * count + lies
        start = 9.0 * len(trials) + 5.0
        done = tuple(
            Command(start + at, "pressure", "set", value, before, phase)
            for at, value, before, phase in commands(pressure)
        )
        point = {"load": load, "mass": BENCH.mass(load), "pressure": pressure}
        flags = np.zeros(len(t), dtype=np.uint16)
        trials.append(TrialData("r1", len(trials), point, 0, False, "finished", start + t, channels, flags, done, {}))
    return _run("contraction-relaxation", BENCH, trials, "r1")


def judged(seed: int) -> Row:
    """Symbol and pressure -> error and half width of the interval, relative to the truth; nan where none is told."""
    found, _ = gather([campaign(seed)])
    assert found is not None
    pooled = pool(found, {})
    assert pooled is not None
    return _row(estimates_of(pooled)[0])


def _row(estimates: Iterable[Estimate]) -> Row:
    row = {(symbol, P): (np.nan, 0.0) for symbol in SERRES for P in WATCHED}
    for e in estimates:
        key = (e.symbol, e.at.get("pressure", 0.0))
        if key in row and e.value is not None:
            true = SERRES[e.symbol](e.at["pressure"])
            row[key] = e.value / true - 1, (e.parts.combined or 0.0) / true
    return row


def study(seeds: range, processes: int = 1) -> list[Row]:
    """The judged campaigns of many seeds."""
    if processes == 1:
        return [judged(seed) for seed in seeds]
    with ProcessPoolExecutor(processes) as executor:
        return list(executor.map(judged, seeds, chunksize=5))


def hits(rows: Iterable[Row]) -> dict[tuple[str, float], tuple[int, int]]:
    """Per coefficient: how often the interval holds the truth, of how many campaigns; one without a value holds none."""
    rows = list(rows)
    return {key: (sum(abs(row[key][0]) < row[key][1] for row in rows), len(rows)) for key in rows[0]}


def clopper_pearson(k: int, n: int, level: float = 0.99) -> tuple[float, float]:
    """Exact interval of a share that came up k times in n (Clopper and Pearson 1934)."""
    tail = (1 - level) / 2
    return float(beta.ppf(tail, k, n - k + 1)) if k else 0.0, float(beta.ppf(1 - tail, k + 1, n - k)) if k < n else 1.0


def table(rows: list[Row]) -> str:
    """Per coefficient: share covered with its interval, mean and standard deviation of the error, mean half width."""
    lines = [f"{'':6s}{'kPa':>5s}{'covered':>9s}{'99 % interval':>18s}{'error [%]':>11s}{'s [%]':>8s}{'half [%]':>10s}"]
    for (symbol, P), (k, n) in hits(rows).items():
        errors, halves = np.array([row[symbol, P] for row in rows]).T
        low, high = clopper_pearson(k, n)
        lines.append(
            f"{symbol:6s}{P / 1e3:5.0f}{k / n:9.3f}{low:10.3f} ..{high:6.3f}{100 * np.nanmean(errors):+11.4f}"
            f"{100 * np.nanstd(errors):8.4f}{100 * halves.mean():10.4f}"
        )
    return "\n".join(lines)
