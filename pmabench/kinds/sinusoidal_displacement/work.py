"""Work along driven sines: what the muscle gives while contracting, and its share of what it took up while expanding.

    W_c = integral of F dx while x rises,  W_c + W = -integral of F dx while x falls,  eta = W_c / (W_c + W)

with W the area of the loop. The pressure is held, so the air takes part in both; what it carries in and out is not
measured, and eta is no efficiency of the drive. Knows measured trials of one pressure, mean and amplitude.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi

import numpy as np

from pmabench.analysis.results import Estimate, Parts
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.lines import mean_half
from pmabench.analysis.shared.sine_loop import RECOVERED, Sine, moving
from pmabench.analysis.shared.skew import settled
from pmabench.kinds.sinusoidal_displacement.fit import BETWEEN, CYCLES, NO_REPEATS, Member
from pmabench.store.records import Array

METHOD = "loop-work"


def work(sine: Sine) -> tuple[Array, Array]:
    """Work given while contracting and taken up while expanding [J] in each cycle, shapes (cycles,).

    The rate is that of the displacement's first five harmonics, so that noise is not counted as motion.
    """
    _, v = moving(sine)
    cycle = np.floor((sine.t - sine.t[0]) * sine.frequency + 1e-6).astype(int)
    rows = [cycle == c for c in range(int(cycle.max()) + 1)]
    period = 1 / sine.frequency
    given = [float(np.mean(sine.F[one] * np.maximum(v[one], 0.0))) * period for one in rows if one.any()]
    taken = [float(np.mean(sine.F[one] * np.maximum(-v[one], 0.0))) * period for one in rows if one.any()]
    return np.array(given), np.array(taken)


def estimates(at: Mapping[str, float], members: Sequence[Member], scales: Scales, skew: float) -> list[Estimate]:
    """W_c [J] and eta [1] at each frequency.

    Calibration, to first order: W_c ~ F x; the gains of both cancel in eta. An offset of the force is worth the stroke
    times that in W_c. Method: what W_c leaves of the loop's area by samples.
    """
    found = []
    for frequency in sorted({member.sine.frequency for member in members}):
        mine = [member for member in members if member.sine.frequency == frequency]
        pairs = [work(member.sine) for member in mine]
        given = [pair[0] for pair in pairs]
        share = [pair[0] / pair[1] for pair in pairs]
        area = float(np.mean([member.sine.area for member in mine]))
        W_c, taken = (float(np.mean([pair[i].mean() for pair in pairs])) for i in (0, 1))
        off = abs(taken - W_c - area)
        stroke = 2 * float(np.mean([member.sine.amplitude for member in mine]))
        sine = mine[0].sine
        late = pi * sine.amplitude**2 * abs(sine.stiffness) * sine.omega * skew
        eta = W_c / taken
        one_each = CYCLES if len(mine) == 1 else ""
        for symbol, unit, quantity, values, parts, note in (
            (
                "W_c", "J", "work", given,
                Parts(None, off, scales.part({"force": W_c, "displacement": W_c}, {"force": stroke}), late / 2), "",
            ),
            (
                "eta", "1", "ratio", share,
                Parts(None, off / taken, scales.part({}, {"force": stroke * (1 - eta) / taken}), late / taken),
                RECOVERED,
            ),
        ):  # fmt: skip
            means = np.array([float(one.mean()) for one in values])
            half = mean_half(means, values)
            one = Estimate(
                symbol,
                float(means.mean()),
                unit,
                quantity,
                METHOD,
                {**at, "frequency": frequency},
                Parts(half, parts.method, parts.calibration, parts.skew),
                len(mine),
                note=sentences(NO_REPEATS if half is None else one_each, note),
                trials=tuple(member.name for member in mine),
            )
            found.append(settled(one, BETWEEN, skew))
    return found
