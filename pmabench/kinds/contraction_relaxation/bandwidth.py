"""Small-signal bandwidth (-3 dB) of contraction under pressure command: from what is fitted, and from recorded steps.

From the coefficients, at a pressure and with the mass of a load, the command goes through the regulator's lags and the
muscle (dead time turns the phase alone):

    |G|^2 = 1 / prod(1 + (omega T_i)^2)  K^2 / ((K - M omega^2)^2 + (B omega)^2),  B = (B_c + B_r)/2

From a step of the command to the contraction y(t), 0 to 1 from its start to its rest, without a model:

    G(j omega) = 1 - j omega integral of (1 - y(t)) exp(-j omega t) dt

The bandwidth is where |G| first falls to 1/sqrt(2). Friction, which holds small motions, is in neither.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import hypot, inf, pi, sqrt

import numpy as np

from pmabench.analysis.results import Estimate, Finding, Parts
from pmabench.analysis.shared.calibration import sentences
from pmabench.analysis.shared.student import half_width
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.regulator_response import Response
from pmabench.kinds.contraction_relaxation.segments import Gate
from pmabench.kinds.contraction_relaxation.trials import Campaign
from pmabench.store.records import Array, TrialData

MODEL, STEP = "bandwidth, by coefficients", "bandwidth, by steps"
LOWEST, HIGHEST = 0.01, 200.0
"""Where it is looked for [Hz]."""
LEVEL = sqrt(0.5)
EXACT = 1e-9
"""It is found within this share of itself, or of the gain [1]."""
LEAST_STEP = 1e-3
"""Steps that move less tell nothing of a bandwidth [m]."""
NEAR_REST = 0.03
"""Share of a step that it may still move by in the last fifth of its hold."""
SHIFT = 1e-3
TOGETHER = 0.01
"""Samples of a step over so long [s] are taken as one: 4e-5 of the gain at 0.5 Hz."""


def crossing(gain: Callable[[Array], Array]) -> float | None:
    """Lowest frequency [Hz] from which on |G| is below 1/sqrt(2); None where it is not looked for."""
    f = np.geomspace(LOWEST, HIGHEST, 120)
    for first in range(0, len(f), 12):
        below = first + np.flatnonzero(gain(f[first : first + 12]) < LEVEL)
        if len(below):
            break
    if not len(below) or below[0] == 0:
        return None
    low, high = float(f[below[0] - 1]), float(f[below[0]])
    over, under = (float(g) - LEVEL for g in gain(np.array([low, high])))
    for _ in range(60):  # regula falsi, the end that stays for the second time counting half
        middle = high - under * (high - low) / (under - over)
        off = float(gain(np.array([middle]))[0]) - LEVEL
        if abs(off) < EXACT or high - low < EXACT * low:
            return middle
        if off < 0:
            high, under, over = middle, off, 0.5 * over
        else:
            low, over, under = middle, off, 0.5 * under
    return sqrt(low * high)


def of_model(K: float, B: float, M: float, lags: Sequence[float]) -> float | None:
    """Bandwidth [Hz] with K [N/m], B [N.s/m], M [kg] and the regulator's lags [s]."""

    def gain(f: Array) -> Array:
        omega = 2 * pi * f
        muscle = K**2 / ((K - M * omega**2) ** 2 + (B * omega) ** 2)
        return np.asarray(np.sqrt(muscle / np.prod([1 + (omega * T) ** 2 for T in lags], axis=0)))

    return crossing(gain) if K > 0 and B >= 0 else None


def of_step(t: Array, y: Array) -> float | None:
    """Bandwidth [Hz] of a response y (n,), from 0 to 1 and at rest at its end; t (n,) since the command [s]."""
    weights = np.gradient(t)
    weights[[0, -1]] *= 0.5
    left = (1 - y) * weights
    begins = np.arange(0, len(t), max(1, int(TOGETHER * (len(t) - 1) / (t[-1] - t[0]))))
    left, t = np.add.reduceat(left, begins), np.add.reduceat(t, begins) / np.diff([*begins, len(t)])

    def gain(f: Array) -> Array:
        omega = 2 * pi * f
        turn = np.outer(omega, t)  # 1 - i omega (sum of left exp(-i turn)), in real numbers for speed
        return np.asarray(np.hypot(1 - omega * (np.sin(turn) @ left), omega * (np.cos(turn) @ left)))

    return crossing(gain)


def estimates(campaign: Campaign, found: Sequence[Estimate], responses: dict[float, Response]) -> list[Estimate]:
    """f_b [Hz] at each tested pressure with the least and the largest load, by the coefficients and by steps.

    `found` are the primary method's estimates. Method part: what B_c and B_r are apart is worth, beside what the parts
    of K and B are; of steps, half the difference of the gain with and without their last fifth.
    """
    loads = sorted({sample.load for sample in campaign.samples})
    chosen = list(dict.fromkeys((loads[0], loads[-1])))
    by = {(e.symbol, e.at["pressure"]): e for e in found if set(e.at) == {"pressure"} and e.value is not None}
    made = []
    for P in campaign.tested:
        for load in chosen:
            one = _by_coefficients(campaign, P, load, by, responses.get(P))
            made += [one] if one is not None else []
    for load in chosen:
        made += _by_steps(campaign, load)
    return made


def _by_coefficients(
    campaign: Campaign, P: float, load: float, by: dict[tuple[str, float], Estimate], response: Response | None
) -> Estimate | None:
    """At one pressure [Pa] with one load [N]; None where a coefficient or the regulator is not known."""
    needed = [by.get((symbol, P)) for symbol in ("K", "B_c", "B_r")]
    if response is None or any(e is None for e in needed):
        return None
    known = [e for e in needed if e is not None]
    K, B_c, B_r = (float(e.value or 0.0) for e in known)
    M = next(_mass(campaign, i) for i, sample in enumerate(campaign.samples) if sample.load == load)
    lags = response.times[1:]
    value = of_model(K, 0.5 * (B_c + B_r), M, lags)
    if value is None:
        return None

    def change(K: float, B: float, lags: Sequence[float]) -> float:
        return (of_model(K, B, M, lags) or value) - value

    B = 0.5 * (B_c + B_r)
    by_K = change(K * (1 + SHIFT), B, lags) / (SHIFT * K)
    by_B = 0.5 * change(K, B * (1 + SHIFT), lags) / (SHIFT * B)
    by_lag = [
        change(K, B, [T * (1 + SHIFT * (i == j)) for j, T in enumerate(lags)]) / (SHIFT * lag)
        for i, lag in enumerate(lags)
    ]
    slopes = (by_K, by_B, by_B)

    def part(name: str) -> float | None:
        values = [getattr(e.parts, name) for e in known]
        if any(v is None for v in values):
            return None
        return hypot(*(slope * v for slope, v in zip(slopes, values, strict=True)))

    repeats = part("repeats")
    times = hypot(*(slope * 1.96 * error for slope, error in zip(by_lag, response.errors[1:], strict=True)))
    apart = 0.5 * abs(change(K, B_c, lags) - change(K, B_r, lags))
    parts = Parts(
        None if repeats is None else hypot(repeats, times),
        hypot(part("method") or 0.0, apart),
        part("calibration"),
        part("skew") or 0.0,
        part("drift") or 0.0,
    )
    note = f"K, (B_c + B_r)/2, M {M:.3g} kg, regulator {' and '.join(show(T, 'time', 3) for T in lags)}"
    names = tuple(dict.fromkeys(name for e in known for name in e.trials))
    at = {"pressure": P, "load": load}
    return Estimate("f_b", value, "Hz", "frequency", MODEL, at, parts, len(names), note=note, trials=names)


def _mass(campaign: Campaign, number: int) -> float:
    return float(campaign.trials[number].point.get("mass", campaign.samples[number].mass))


def _by_steps(campaign: Campaign, load: float) -> list[Estimate]:
    """At the pressures that partial steps lead to, all trials with a load [N]."""
    groups: dict[float, list[tuple[str, float, float, float]]] = {}
    for number, sample in enumerate(campaign.samples):
        if sample.load != load:
            continue
        trial = campaign.trials[number]
        for target, by, t, y in _steps(campaign, number, trial):
            value, short = of_step(t, y), of_step(t[: -len(t) // 5], y[: -len(t) // 5])
            if value is not None and short is not None:
                groups.setdefault(target, []).append((campaign.name(number), by, value, abs(value - short) / 2))
    made = []
    common, freedom = _scatter(groups)
    for target, rows in sorted(groups.items()):
        values = np.array([row[2] for row in rows])
        se = float(values.std(ddof=1)) / sqrt(len(values)) if len(values) > 1 else None
        pooled = half_width(common * float(values.mean()) / sqrt(len(values)), freedom)
        half = max((one for one in (half_width(se, len(values) - 1), pooled) if one is not None), default=None)
        steps = sorted({round(row[1], -2) for row in rows})
        size = " and ".join(show(abs(by), "pressure", 3) for by in steps)
        note = sentences("" if half is not None else "no repeats part: no step was repeated", f"relaxing by {size}")
        parts = Parts(half, float(np.mean([row[3] for row in rows])), 0.0)
        names = tuple(dict.fromkeys(row[0] for row in rows))
        at = {"pressure": target, "load": load}
        made.append(
            Estimate(
                "f_b", float(values.mean()), "Hz", "frequency", STEP, at, parts, len(rows), note=note, trials=names
            )
        )
    return made


def _scatter(groups: Mapping[float, Sequence[tuple[str, float, float, float]]]) -> tuple[float, int]:
    """Standard deviation of like steps as a share of their mean [1], over all targets, and its degrees of freedom.

    Two repeats agree by chance; all pairs of a campaign do not.
    """
    like: dict[tuple[float, float], list[float]] = {}
    for target, rows in groups.items():
        for _, by, value, _ in rows:
            like.setdefault((target, round(by, -2)), []).append(value)
    off = [np.array(values) / np.mean(values) - 1 for values in like.values()]
    freedom = sum(len(one) - 1 for one in off)
    return (sqrt(sum(float(one @ one) for one in off) / freedom) if freedom else 0.0), freedom


def _steps(campaign: Campaign, number: int, trial: TrialData) -> list[tuple[float, float, Array, Array]]:
    """Target and size [Pa], time since the command [s] and share of the contraction, of each step that ends lifted."""
    samples = campaign.samples[number]
    commands = sorted((c for c in trial.commands if c.output == "pressure"), key=lambda c: c.t)
    ends = [*(c.t for c in commands[1:]), inf]
    found = []
    for command, end in zip(commands, ends, strict=True):
        rows = np.flatnonzero((samples.t >= command.t - 1e-9) & (samples.t < end - 1e-9))
        before = (samples.t < command.t - 1e-9) & (samples.t > command.t - 0.2) & samples.ok
        if command.phase != "relax" or command.kind != "set" or len(rows) < 100 or not before.any():
            continue
        if not samples.ok[rows].all():
            continue
        t, x = samples.t[rows] - command.t, samples.x[rows]
        start, rest = float(samples.x[before].mean()), float(x[-len(x) // 20 :].mean())
        creeps = abs(float(x[-len(x) // 5 : -len(x) // 10].mean()) - rest)
        if abs(rest - start) < LEAST_STEP or rest < Gate.lift or creeps > NEAR_REST * abs(rest - start):
            continue
        found.append((command.value, command.value - command.before, t, (x - start) / (rest - start)))
    return found


def findings(estimates: Sequence[Estimate]) -> list[Finding]:
    """From where to where it goes, and how the two ways agree at the same pressure and load."""
    model = {tuple(e.at.values()): e for e in estimates if e.method == MODEL}
    steps = {tuple(e.at.values()): e for e in estimates if e.method == STEP}
    if not model:
        return []
    low, high = (min(model.values(), key=_value), max(model.values(), key=_value))
    text = (
        f"small-signal bandwidth of contraction under commanded pressure, -3 dB: {_value(low):.2g} Hz at "
        f"{_where(low)} to {_value(high):.2g} Hz at {_where(high)}, by the coefficients"
    )
    both = [(_value(steps[key]) / _value(model[key])) for key in model if key in steps]
    if both:
        text += f"; recorded steps give {min(both):.2f} to {max(both):.2f} times that" if len(both) > 1 else (
            f"; recorded steps give {both[0]:.2f} times that"
        )  # fmt: skip
    return [Finding("note", text)]


def _value(e: Estimate) -> float:
    return e.value or 0.0


def _where(e: Estimate) -> str:
    return f"{show(e.at['pressure'], 'pressure')} with {show(e.at['load'], 'force', 3)}"
