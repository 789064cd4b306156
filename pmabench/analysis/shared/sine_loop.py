"""One driven sine: harmonics of displacement, force and pressure, area and width of its loop, in total and by cycle.

Also the force of a fitted muscle along the same motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import floor, inf, pi

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared.samples import (
    NotUsable,
    fresh,
    lags_of,
    least_squares,
    noise_of,
    refuse_flagged,
    refuse_incomplete,
    settings_of,
    step_of,
    three_parameter,
)
from pmabench.base.quantities import show
from pmabench.store.records import Array, Flag, RunData, TrialData

MIDDLE = 0.25
"""Distance from mid stroke, over the amplitude, of samples from which the width there is taken."""
PLACE = 0.02
"""Distance of positions, over the amplitude, below which they count as equal for the order of the fit."""
STILL = 1e-9
"""Amplitude below which there is no motion but rounding [m]."""
COARSE, JUMPS = 0.15, 0.4
"""Largest quantisation step over the swing that is evaluated.

Above the second share the channel has two or three values and jumps, which is judged by its form.
"""
FEWEST = 12
"""Fewest samples of a cycle."""
HARMONICS = 5
"""Harmonics kept for the displacement of a replay, and in corrections of lags and delays."""


@dataclass(frozen=True, eq=False)
class Swing:
    """Loop of a driven sine, of a trial or of one cycle: first harmonics, area and width."""

    frequency: float
    """[Hz]."""
    amplitude: float
    """Of the displacement [m]."""
    ratio: complex
    """Force over displacement [N/m]; -K - j (B omega + 4 F_c/(pi A)) for a muscle."""
    area: float
    """Work lost in the loop [J]: -integral of F dx."""
    width: float
    """Force while returning minus force while contracting, at mid stroke [N]."""

    @property
    def omega(self) -> float:
        """[rad/s]."""
        return 2 * pi * self.frequency

    @property
    def speed(self) -> float:
        """Amplitude of the speed omega A [m/s]."""
        return self.omega * self.amplitude

    @property
    def stiffness(self) -> float:
        """K = -Re(F/x) [N/m]."""
        return -self.ratio.real

    @property
    def loss(self) -> float:
        """-Im(F/x) A = B omega A + 4 F_c/pi [N]."""
        return -self.ratio.imag * self.amplitude

    @property
    def phase(self) -> float:
        """Phase by which the pull leads the extension [rad]: atan(Im/Re)."""
        return float(np.arctan2(-self.ratio.imag, -self.ratio.real))

    def less(self, loss: float) -> Swing:
        """A copy with the loss reduced by `loss` [N] and the width at mid stroke by twice that."""
        return Swing(
            self.frequency, self.amplitude, self.ratio + 1j * loss / self.amplitude, self.area, self.width - 2 * loss
        )

    def turned(self, by: float) -> Swing:
        """A copy with the force `by` [s] earlier; the width at mid stroke grows by twice the change of the loss."""
        ratio = self.ratio * complex(np.exp(1j * self.omega * by))
        more = -ratio.imag * self.amplitude - self.loss
        return Swing(self.frequency, self.amplitude, ratio, self.area, self.width + 2 * more)


@dataclass(frozen=True, eq=False)
class Sine(Swing):
    """A trial measured over whole cycles: x(t) = mean + Re(X exp(j omega t)); arrays of shape (n,)."""

    t: Array
    x: Array
    F: Array
    mean: float
    """Of the displacement [m]."""
    force: float
    """Mean force [N]."""
    pressure: float
    """Mean pressure [Pa]; nan where it is not recorded."""
    ripple: complex
    """Complex amplitude of the pressure at the sine's frequency, relative to the phase of the displacement [Pa]."""
    distortion: float
    """Rms of the displacement minus its sine, over the rms of the sine [1]."""
    cycles: tuple[Swing, ...]
    steps: tuple[float, float] = (0.0, 0.0)
    """Quantisation steps of displacement [m] and force [N]; 0 for none."""

    @cached_property
    def motion(self) -> Waves:
        """Harmonics of the displacement."""
        return Waves(self.t, self.x, self.frequency)


def measure(
    run: RunData, trial: TrialData, discard: float, force_per_pressure: float = 0.0,
    later: Mapping[str, float] | None = None, delay: float = 0.0,
) -> Sine:  # fmt: skip
    """The sine of a trial without the first `discard` cycles, corrected for the lags of the sensors.

    With `force_per_pressure` [N/Pa] the force from pressure at the sine's frequency is subtracted. `later` [s] is added
    to the declared lags, and `delay` [s] is an additional delay of the force. Raises `NotUsable` where the trial ended
    early, lacks a channel, went slack, has too many flagged samples, or is sampled too rarely or coarsely.
    """
    refuse_incomplete(trial, "displacement", "force")
    frequency = trial.point.get("frequency", 0.0)
    if frequency <= 0:
        raise NotUsable("its point names no frequency")
    window = _window(trial, frequency, discard)
    t, x, F = trial.t[window], trial.channels["displacement"][window], trial.channels["force"][window]
    slack = int(np.count_nonzero(trial.flags[window] & np.uint16(Flag.SLACK)))
    if slack or F.min() <= 3 * noise_of(F):
        raise NotUsable(f"the specimen was slack: force down to {show(float(F.min()), 'force', 3)}")
    refuse_flagged(trial.usable[window])
    good = trial.usable[window] & fresh(x) & fresh(F)
    cycles = (t[-1] - t[0]) * frequency
    if good.sum() < FEWEST * floor(cycles + 0.5):
        often = f"{good.sum() / cycles:.2g} times a cycle, and held in between"
        raise NotUsable(f"displacement and force are new {often}: {FEWEST} times are needed, read them more often")
    t, x, F = t[good], x[good], F[good]
    steps = step_of(x), step_of(F)
    for name, y, step in zip(("displacement", "force"), (x, F), steps, strict=True):
        swing = float(np.ptp(y))
        if step > COARSE * swing and not JUMPS * swing < step < inf:
            raise NotUsable(f"{name} has steps above {COARSE:.0%} of its swing: swing more, or read it in finer ones")
    lag = {name: declared + (later or {}).get(name, 0.0) for name, declared in lags_of(run, trial).items()}
    x, F = without_lag(t, x, frequency, lag["displacement"]), without_lag(t, F, frequency, lag["force"])
    F = earlier(t, F, frequency, delay)
    pressure, ripple = float("nan"), 0j
    if "pressure" in trial.channels:
        mean, amplitude = three_parameter(t, np.column_stack([trial.channels["pressure"][window][good], x]), frequency)
        P = complex(amplitude[0]) * (1 + 2j * pi * frequency * lag["pressure"])
        pressure, ripple = float(mean[0]), P * complex(np.exp(-1j * np.angle(amplitude[1])))
        if force_per_pressure:
            F = F - force_per_pressure * np.real(P * np.exp(2j * pi * frequency * t))
    return replace(evaluate(t, x, F, frequency, pressure, ripple), steps=steps)


def _window(trial: TrialData, frequency: float, discard: float) -> slice:
    """Samples of whole cycles since the command of the sine, without the first `discard` cycles."""
    command = next((c for c in trial.commands if c.kind == "sine"), None)
    begin = float(trial.t[0]) if command is None else command.t
    cycles = trial.point.get("cycles") if command is None else command.data.get("cycles")
    end = float(trial.t[-1]) + float(np.median(np.diff(trial.t)))
    if cycles is not None:
        end = min(end, begin + float(cycles) / frequency)
    begin += discard / frequency
    whole = floor((end - begin) * frequency + 0.01)
    if whole < 1:
        raise NotUsable("it holds no whole cycle beyond those left out")
    first, last = np.searchsorted(trial.t, [begin - 1e-9, begin + whole / frequency - 1e-9])
    if last - first < FEWEST * whole:
        raise NotUsable(f"fewer than {FEWEST} samples a cycle")
    return slice(int(first), int(last))


def evaluate(
    t: Array, x: Array, F: Array, frequency: float, pressure: float = float("nan"), ripple: complex = 0j, *,
    by_cycle: bool = True,
) -> Sine:  # fmt: skip
    """Harmonics, area and width of the loop of displacement `x` [m] and force `F` [N] at `t` [s], shape (n,) each.

    `cycles` is empty unless `by_cycle`. Raises `NotUsable` where the displacement is within its noise.
    """
    omega = 2 * pi * frequency
    both = np.column_stack([x, F])
    means, amplitudes = three_parameter(t, both, frequency)
    X = complex(amplitudes[0])
    if abs(X) < max(6 * noise_of(x), STILL):
        raise NotUsable("the displacement does not move above its noise")
    left = x - means[0] - np.real(X * np.exp(1j * omega * t))
    whole = max(1, round((t[-1] - t[0]) * frequency))
    edges = np.searchsorted(t, t[0] + np.arange(whole + 1) / frequency - 1e-9)
    cycles = []
    for first, last in pairwise(edges) if by_cycle else ():
        one = slice(int(first), int(last))
        _, a = three_parameter(t[one], both[one], frequency)
        width = float(np.subtract(*at_middle(t[one], x[one], F[one], float(means[0]), X, omega)))
        area = lost_work(x[one], F[one])
        cycles.append(Swing(frequency, abs(complex(a[0])), complex(a[1] / a[0]), area, width))
    return Sine(
        frequency=frequency,
        amplitude=abs(X),
        ratio=complex(amplitudes[1] / amplitudes[0]),
        area=lost_work(x, F) / whole,
        width=float(np.subtract(*at_middle(t, x, F, float(means[0]), X, omega))),
        t=t,
        x=x,
        F=F,
        mean=float(means[0]),
        force=float(means[1]),
        pressure=pressure,
        ripple=ripple,
        distortion=float(np.sqrt(2.0 * np.mean(left**2))) / abs(X),
        cycles=tuple(cycles),
    )


def lost_work(x: Array, F: Array) -> float:
    """Work lost along a path that is closed from its last sample to its first: -integral of F dx [J]."""
    ahead, pull = np.append(x[1:], x[0]), np.append(F[1:], F[0])
    return -float(np.sum(0.5 * (F + pull) * (ahead - x)))


def at_middle(t: Array, x: Array, F: Array, mean: float, X: complex, omega: float) -> tuple[float, float]:
    """Force while returning and while contracting at `mean` [N], by parabolas through middle samples; NaN without."""
    position = (x - mean) / abs(X)
    middle = np.abs(position) < MIDDLE
    position, F = position[middle], F[middle]
    contracting = np.real(1j * X * np.exp(1j * omega * t[middle])) > 0
    at: list[float] = []
    for branch in (~contracting, contracting):
        order = min(2, len(np.unique(np.round(position[branch] / PLACE))) - 1)
        if order < 0:
            return float("nan"), float("nan")
        at.append(float(np.polyfit(position[branch], F[branch], order)[-1]))
    return at[0], at[1]


class Waves:
    """Mean and up to `HARMONICS` harmonics of `y` over `t` [s], by least squares; shape (n,) each."""

    def __init__(self, t: Array, y: Array, frequency: float) -> None:
        order = max(1, min(HARMONICS, int(0.2 * len(t) / max(1.0, (t[-1] - t[0]) * frequency))))
        self._k = 2 * pi * frequency * np.arange(1, order + 1)
        turn = np.exp(1j * self._k[0] * t)
        turns = np.cumprod(np.broadcast_to(turn[:, None], (len(t), order)), axis=1)  # exp(j k t)
        self._waves = np.column_stack([turns.real, turns.imag])
        fitted = least_squares(np.column_stack([np.ones_like(t), self._waves]), y)
        self._mean, self._amplitude = fitted[0], fitted[1 : order + 1] - 1j * fitted[order + 1 :]

    def value(self, by: float = 0.0) -> Array:
        """Value `by` [s] after `t`, shape (n,)."""
        return np.asarray(self._mean + self._sum(self._amplitude * np.exp(1j * self._k * by)))

    def slope(self) -> Array:
        """Derivative [1/s times the unit of y], shape (n,)."""
        return self._sum(np.asarray(1j * self._k * self._amplitude, dtype=np.complex128))

    def _sum(self, amplitude: NDArray[np.complex128]) -> Array:
        return np.asarray(self._waves @ np.concatenate([amplitude.real, -amplitude.imag]))


def without_lag(t: Array, y: Array, frequency: float, lag: float) -> Array:
    """Input of a first-order `lag` [s] with output `y`: y + lag y', with y' from harmonics; noise is unchanged."""
    return y + lag * Waves(t, y, frequency).slope() if lag else y


def earlier(t: Array, y: Array, frequency: float, by: float) -> Array:
    """`y` with its harmonics `by` [s] earlier, as the input of a delay; noise is unchanged."""
    if not by:
        return y
    waves = Waves(t, y, frequency)
    return y + waves.value(by) - waves.value()


def along(sine: Sine, K: float, B: float, F_c: float) -> tuple[Array, Array]:
    """Harmonics of the displacement [m] and F = const - K x - B x' - F_c sign x' [N] at the trial's times.

    The constant is such that the mean force is that of the trial.
    """
    x, v = sine.motion.value(), sine.motion.slope()
    F = -K * (x - sine.mean) - B * v - F_c * np.sign(v)
    return x, F + sine.force - float(three_parameter(sine.t, F[:, None], sine.frequency)[0][0])


def replay(sine: Sine, K: float, B: float, F_c: float) -> Sine:
    """Evaluation of the trial with the force of a fitted muscle, which shows the bias of the estimator."""
    x, F = along(sine, K, B, F_c)
    return evaluate(sine.t, x, F, sine.frequency, by_cycle=False)


def stiffness_of(run: RunData, trial: TrialData) -> float:
    """Stiffness of one trial [N/m], without the first cycles by the plan; raises `NotUsable`."""
    return measure(run, trial, float(settings_of(run).get("discard", 1))).stiffness
