"""Sines of pressure from other programs: amplitude and phase of pressure and contraction, and the width of the loop.

Uses trials of a known frequency with measured pressure and displacement, from any source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import floor, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis import imported
from pmabench.analysis.shared import samples
from pmabench.analysis.shared.calibration import Scales, listed, sentences
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.lines import mean_half
from pmabench.analysis.shared.samples import UNDECLARED, NotUsable, fresh, lags_of, three_parameter
from pmabench.analysis.shared.sine_loop import without_lag
from pmabench.analysis.shared.trials import measured_trials
from pmabench.base.quantities import show
from pmabench.kinds.recorded_sine import RESULTS
from pmabench.kinds.recorded_sine.form import bandwidth, changing, cut_off, hysteresis, other_shape, play, sensors
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, Flag, RunData, TrialData

KIND = "recorded-sine"
METHOD = "sine-harmonic"
SETTLE = 1.0
"""Left out at the start [s], rounded up to whole cycles."""
AT_REST, A_SINE = 0.5, 0.25
"""Cycles with an amplitude below AT_REST of the median, or with a residual of the sine above A_SINE, are left out."""
LEAST = 12
"""Samples a cycle that are needed."""
UNUSABLE_SHARE = 0.1
MOVED = ("pressure", "displacement")
UNFILTERED = (
    "no `sensor_lag` is declared of {}: a filter of up to {} of each is in the intervals, most of all of phases and H. "
    "Declare its time constant with the channel in the map; 0.01 ms says that there is no filter"
)
OFF = 0.005
"""Relative difference between stated and commanded frequency from which on it is a doubt."""
CYCLES = "one trial: the repeats part is the scatter of its cycles, and repeated tests may scatter more"
ANOTHER = 1.05
"""Sines whose drive is larger by this factor are not repeats."""
SURE = 5.0
"""Standard deviations from which on the frequency differs from the stated one."""
AMPLIFIED = 0.03
"""Share by which a pressure may swing further than its command at the lowest frequency [1]."""
NO_SINE = 0.1
"""Residual of the first harmonic, as a share of the signal, from which on it is reported."""
Complex = NDArray[np.complex128]
Values = tuple[list[float], list[Array]]
"""A value of each trial as a whole, and of its cycles."""


@dataclass(frozen=True, eq=False)
class Sine:
    """One trial over whole cycles: x(t) = mean + Re(X exp(j omega t)) and so on; `cycles` has one amplitude for each
    cycle.
    """

    trial: TrialData
    frequency: float
    """[Hz]."""
    t: Array
    P: Array
    x: Array
    raw: Mapping[str, Array]
    """All channels as recorded; `P` and `x` are corrected for drift and for lags of the sensors."""
    lags: Mapping[str, float]
    """Time constants of the sensors [s], as declared."""
    amplitudes: Mapping[str, complex]
    """Of `pressure` [Pa], `displacement` [m] and, where recorded, `pressure_command` [Pa]."""
    cycles: Mapping[str, Complex]
    left: Mapping[str, float]
    """Rms residual of the first harmonic over the rms of the signal about its mean [1]."""
    late: Mapping[str, tuple[float, float]]
    """Range of the delay of pressure and displacement behind their stamps [s]; (0, 0) where unknown."""
    off: float
    """Relative deviation of the drive's frequency (command, else pressure) from the stated one [1]; 0 if not
    significant.
    """

    @property
    def name(self) -> str:
        """`run/index`."""
        return self.trial.name

    @property
    def omega(self) -> float:
        """[rad/s]."""
        return 2 * pi * self.frequency * (1 + self.off)

    @property
    def drive(self) -> float:
        """Amplitude of the pressure command, else of the pressure [Pa]."""
        return abs(self.amplitudes.get("pressure_command", self.amplitudes["pressure"]))

    def turn(self, upper: str, lower: str) -> float:
        """Correction [rad] of the phase of `upper` over `lower` for the middle of their delays."""
        late = {name: sum(ends) / 2 for name, ends in self.late.items()}
        return self.omega * (late.get(upper, 0.0) - late.get(lower, 0.0))

    def apart(self, *names: str) -> float:
        """Half width of the time between channels about that middle [s]."""
        return sum((self.late[name][1] - self.late[name][0]) / 2 for name in names)


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """Per frequency [Hz]: |P| [Pa], |x| [m], |P/x| [Pa/m], phases [rad] and the width of the x-P loop [m].

    Repeats are sines of one frequency and one amplitude. Three-parameter sine fits (IEEE 1057) at the known frequency,
    over whole cycles after the first second. `phi_x` is the phase of x against the measured pressure, `phi_P` that of
    the pressure against its command, both negative for a lag. H = 2 |x| |sin phi_x| is the width of the ellipse at mean
    pressure. The pressure may be older than its stamps (`late_by` of the map): phases are corrected by the middle of
    that range, and half of it is the `method` part. Lags of sensors (`sensor_lag`, first order) are corrected:
    amplitudes are multiplied by 1 + j omega tau, with an uncertainty of a fifth of tau, or of `UNDECLARED` where none
    is declared. The bandwidth is that of `bandwidth`. K and B do not follow from x and P alone, since F_ce(P) is
    between them.
    """
    sines, dropped = measured_trials(runs, lambda run, trial: (run, measure(run, trial)))
    read_off = imported.apart_is_known(runs)
    groups: dict[float, list[list[tuple[RunData, Sine]]]] = {}
    for run, sine in sorted(sines, key=lambda one: one[1].drive):
        alike = groups.setdefault(round(sine.frequency, 6), [])
        if not alike or sine.drive > ANOTHER * alike[-1][0][1].drive:
            alike.append([])
        alike[-1].append((run, sine))
    estimates = [
        e for _, alike in sorted(groups.items()) for group in alike
        for e in _at(group, alone=len(alike) == 1, read_off=read_off)
    ]  # fmt: skip
    usual = float(np.median([sine.drive for _, sine in sines])) if sines else 0.0
    swept = {f: min(alike, key=lambda group: abs(group[0][1].drive - usual)) for f, alike in groups.items()}
    estimates += bandwidth({f: [sine for _, sine in group] for f, group in swept.items()})
    text = "{} ({}): it runs {:+.1%} off the frequency that the name tells; the real one is fitted"
    findings = [
        Finding("doubt", text.format(show(sine.frequency, "frequency", 3), sine.name, sine.off))
        for _, sine in sines
        if abs(sine.off) > OFF
    ]
    if sines and not read_off:
        findings.append(
            Finding("doubt", f"{imported.UNTOLD_TIME}: phases assume at most {show(imported.UNTOLD, 'time')}")
        )
    silent = [n for n in MOVED if any(not sine.lags[n] for _, sine in sines)]
    if silent:
        findings.append(Finding("note", UNFILTERED.format(listed(silent), show(UNDECLARED, "time"))))
    first = [group[0][1] for _, group in sorted(swept.items())]
    if any(len(alike) > 1 for alike in groups.values()):
        text = "sines of one frequency whose amplitudes differ by more than a twentieth are reported apart"
        findings.append(Finding("note", text))
    findings += _over_frequency(first)
    if estimates:
        text = "no method part but for lateness and lag of the channels; how far these differ from sines is stated"
        findings.append(Finding("note", f"{text} above"))
    findings = [*imported.import_findings(runs), *findings]
    traces = [_loop(sine) for sine in first] + ([_bode(first)] if first else [])
    facts = {
        "trials": len(sines),
        "frequencies": sorted(groups),
        "flagged": imported.flagged_counts(runs),
        "left_by_first_harmonic": {sine.name: dict(sine.left) for _, sine in sines},
    }
    return Analysis.of(
        KIND, runs, results=RESULTS, estimates=estimates, dropped=dropped, findings=findings, traces=traces, facts=facts
    )


def measure(run: RunData, trial: TrialData) -> Sine:
    """One trial from its samples; raises `NotUsable`."""
    frequency = trial.point.get("frequency", 0.0)
    samples.refuse_missing(trial, *MOVED)
    if frequency <= 0:
        raise NotUsable("nothing says its frequency: give `point: {frequency: 0.5 Hz}` under `trials` of the map")
    samples.refuse_incomplete(trial)
    start, end = _moving(trial, frequency)
    begin = start + max(1, floor(SETTLE * frequency + 0.999)) / frequency
    whole = floor((end - begin) * frequency + 1e-9)
    window = (trial.t >= begin) & (trial.t < begin + whole / frequency)
    if whole < 2:
        raise NotUsable("it holds fewer than two whole cycles beyond those left out")
    if np.any(trial.flags & np.uint16(Flag.TIME_JUMP)):
        raise NotUsable("its clock jumps: what lies before and after has no common phase")
    if np.mean(~trial.usable[window]) > UNUSABLE_SHARE:
        raise NotUsable(f"too many samples are flagged: {imported.unusable_because(trial)}")
    new = _where_new(trial, window & trial.usable, LEAST * whole)
    names = [n for n in ("pressure", "displacement", "pressure_command") if n in trial.channels]
    t = trial.t[good := min(new.values(), key=np.count_nonzero)]
    number = np.floor((trial.t - begin) * frequency + 1e-9)
    read = [_read_at(trial, name, new.get(name, good), good, (number, frequency)) for name in names]
    rows = [number[good] == k for k in range(whole)]
    signals = _without_drift(t, np.column_stack(read), rows)

    def by_cycle(at: float) -> dict[str, Complex]:
        each = np.array([three_parameter(t[row], signals[row], at)[1] for row in rows])
        return {name: each[:, column] for column, name in enumerate(names)}

    cycles = by_cycle(frequency)
    off = _frequency_off(cycles.get("pressure_command", cycles["pressure"]), whole)
    real = frequency * (1 + off)
    lags = lags_of(run, trial)
    signals = np.column_stack(
        [without_lag(t, signals[:, column], real, lags[name]) for column, name in enumerate(names)]
    )
    cycles = by_cycle(real)
    means, amplitudes = three_parameter(t, signals, real)
    model = means + np.real(np.exp(2j * pi * real * t)[:, None] * amplitudes[None, :])
    left = np.std(signals - model, axis=0) / np.maximum(np.std(signals, axis=0), 1e-30)
    if not all(np.ptp(trial.channels[name][good]) for name in names[:2]):
        raise NotUsable("pressure or displacement does not move")
    return Sine(
        trial=trial,
        frequency=frequency,
        t=t,
        P=signals[:, 0],
        x=signals[:, 1],
        raw={name: trial.channels[name][good] for name in names},
        lags={name: lags[name] for name in names},
        amplitudes={name: complex(amplitudes[column]) for column, name in enumerate(names)},
        cycles=cycles,
        left={name: float(left[column]) for column, name in enumerate(names)},
        late={name: imported.late_by(run, name) or (0.0, 0.0) for name in MOVED},
        off=off,
    )


def _where_new(trial: TrialData, usable: NDArray[np.bool_], fewest: int) -> dict[str, NDArray[np.bool_]]:
    """`usable` samples at which each channel is new; raises `NotUsable` where they are fewer than `fewest`."""
    new = {name: usable.copy() for name in MOVED}
    for name, rows in new.items():
        rows[usable] = fresh(trial.channels[name][usable])
    least = min(np.count_nonzero(rows) for rows in new.values())
    if np.count_nonzero(usable) < fewest:
        raise NotUsable(f"fewer than {LEAST} usable samples a cycle")
    if least < fewest:
        held = [name for name, rows in new.items() if np.count_nonzero(rows) < fewest]
        text = f"{' and '.join(held)} {'are' if held[1:] else 'is'} new {LEAST * least / fewest:.2g} times a cycle"
        raise NotUsable(f"{text}, and held in between: {LEAST} times are needed, read more often")
    return new


def _read_at(
    trial: TrialData, name: str, new: NDArray[np.bool_], rows: NDArray[np.bool_], cycles: tuple[Array, float]
) -> Array:
    """A channel at the `rows` of another one: where it is held, the sine through the new values of that cycle, and
    what it leaves of them on straight lines. `cycles`: number of the cycle of each sample, and frequency [Hz].
    """
    t, y, (number, frequency) = trial.t, trial.channels[name], cycles
    if not np.any(rows & ~new):
        return np.asarray(y[rows])
    sine = np.zeros(len(t))
    for k in np.unique(number[rows]):
        here = number == k
        mean, wave = three_parameter(t[here & new], y[here & new, None], frequency)
        sine[here] = mean[0] + np.real(np.exp(2j * pi * frequency * t[here]) * wave[0])
    return np.asarray(sine[rows] + np.interp(t[rows], t[new], (y - sine)[new]))


def _moving(trial: TrialData, frequency: float) -> tuple[float, float]:
    """Start and end of the sine [s]; a file may have rests, steps or ramps to the mean before and after it.

    It is the longest sequence of cycles in which the command, else the pressure, is a sine of the usual amplitude. At a
    cut end the neighbouring cycle is left out, too, since it may be only partly a sine.
    """
    begin, end = float(trial.t[0]), float(trial.t[-1])
    drive = trial.channels.get("pressure_command", trial.channels["pressure"])
    known = trial.usable & np.isfinite(drive)
    t, y, number = trial.t[known], drive[known], np.floor((trial.t[known] - begin) * frequency)
    sizes = np.zeros(floor((end - begin) * frequency))
    for k in range(len(sizes)):
        row = number == k
        if np.count_nonzero(row) >= LEAST:
            phase = 2 * pi * (t[row] * frequency - k)
            line, wave = np.column_stack([np.ones_like(phase), phase]), np.column_stack([np.cos(phase), np.sin(phase)])
            both = np.linalg.lstsq(np.hstack([line, wave]), y[row], rcond=None)[0]
            swings = y[row] - line @ both[:2]
            if np.sum((swings - wave @ both[2:]) ** 2) < A_SINE * np.sum(swings**2):
                sizes[k] = float(np.hypot(*both[2:]))
    if not sizes.any():
        return begin, end
    moving = np.flatnonzero(sizes > AT_REST * np.median(sizes[sizes > 0]))
    longest = max(np.split(moving, np.flatnonzero(np.diff(moving) > 1) + 1), key=len)
    return (
        begin + (longest[0] + 1) / frequency if longest[0] > 0 else begin,
        begin + longest[-1] / frequency if longest[-1] < len(sizes) - 1 else end,
    )


def _without_drift(t: Array, signals: Array, rows: Sequence[NDArray[np.bool_]]) -> Array:
    """Signals, shape (n, m), minus the slope of a line through the means of their cycles, which would bias a sine fit.

    The mean of each signal is not changed.
    """
    at = np.array([t[row].mean() for row in rows])
    slopes = np.polyfit(at, np.array([signals[row].mean(axis=0) for row in rows]), 1)[0]
    return np.asarray(signals - (t - t.mean())[:, None] * slopes)


def _frequency_off(driven: Complex, whole: int) -> float:
    """Relative deviation from the stated frequency [1], by the phase's drift over the cycles; 0 if not significant."""
    if whole < 3 or np.any(np.abs(driven) == 0):
        return 0.0
    phase, place = np.unwrap(np.angle(driven)), np.arange(whole) - 0.5 * (whole - 1)
    slope = float(place @ phase / (place @ place))
    error = float(np.sqrt(np.sum((phase - phase.mean() - slope * place) ** 2) / (whole - 2) / (place @ place)))
    return slope / (2 * pi) if abs(slope) > SURE * error else 0.0


def _at(group: Sequence[tuple[RunData, Sine]], *, alone: bool, read_off: bool) -> list[Estimate]:
    """All estimates at one frequency, or if `alone` is False, at one of several amplitudes there.

    `read_off`: whether the time between the channels is known.
    """
    sines = [sine for _, sine in group]
    first = sines[0]
    at = {"frequency": first.frequency}
    if not alone:
        at["amplitude"] = float(f"{np.mean([abs(sine.amplitudes['displacement']) for sine in sines]):.3g}")
    parents = tuple(sine.name for sine in sines)
    scales = Scales.of([run for run, _ in group])
    doubt, doubt_P = (
        first.omega * (max(sine.apart(*names) for sine in sines) if read_off else imported.UNTOLD)
        for names in (MOVED, MOVED[:1])
    )

    def estimate(
        symbol: str, kind: tuple[str, str], values: Values, channels: tuple[str, ...] = (), method: float | None = None,
        note: str = "", doubts: Sequence[Doubt] = (),
    ) -> Estimate:  # fmt: skip
        """The mean of `values`, which are proportional to the readings of some `channels`."""
        whole, by_cycle = values
        value = float(np.mean(whole))
        parts = Parts(mean_half(np.array(whole), by_cycle), method, scales.part(dict.fromkeys(channels, value)))
        few = CYCLES if len(whole) == 1 else ""
        note_text = sentences(note, few, scales.lack(channels))
        e = Estimate(symbol, value, *kind, METHOD, at, parts, len(whole), note=note_text, trials=parents)
        sizes = [replace(d, half=d.half * abs(value)) for d in (*cut_off(sines, channels), *sensors(first, channels))]
        return weighed(e, [*doubts, *sizes, *changing(by_cycle, symbol)], 1.0 if symbol.startswith("phi") else None)

    phase, phase_by = _phases(sines, "displacement", "pressure")
    x, x_by = _sizes(sines, "displacement")
    width = [2 * size * abs(np.sin(p)) for size, p in zip(x, phase, strict=True)]
    width_by = [2 * size * np.abs(np.sin(p)) for size, p in zip(x_by, phase_by, strict=True)]
    late = "lateness taken as the middle of its range" if read_off else imported.UNTOLD_TIME
    slow = [*sensors(first, MOVED, phase=True), *hysteresis(sines, scales.offsets, MOVED), *play(sines, phase=True)]
    loose = play(sines)
    gains = _sizes(sines, *MOVED)
    sized = [[replace(one, half=one.half * float(np.mean(of))) for one in loose] for of in (x, gains[0])]
    shape = [*other_shape(sines), *(replace(one, half=_width_by(first, phase[0], one.half)) for one in slow)]
    found = [
        estimate("P", ("Pa", "pressure"), _sizes(sines, "pressure"), ("pressure",)),
        estimate("x", ("m", "length"), (x, x_by), ("displacement",), doubts=sized[0]),
        estimate("P/x", ("Pa/m", "gain"), gains, MOVED, doubts=sized[1]),
        estimate("phi_x", ("rad", "angle"), (phase, phase_by), method=doubt or None, note=late, doubts=slow),
        estimate("H", ("m", "length"), (width, width_by), ("displacement",),
                 _width_by(first, phase[0], doubt) or None, late, shape),
    ]  # fmt: skip
    if all("pressure_command" in s.amplitudes for s in sines):
        driven = ("pressure", "pressure_command")
        slow = [*sensors(first, driven, phase=True), *hysteresis(sines, scales.offsets, driven)]
        found += [
            estimate("P/P_set", ("1", "ratio"), _sizes(sines, *driven), ("pressure",)),
            estimate("phi_P", ("rad", "angle"), _phases(sines, *driven), (), doubt_P or None, late, slow),
        ]
    return found


def _sizes(sines: Sequence[Sine], upper: str, lower: str = "") -> Values:
    """Amplitude of `upper`, divided by that of `lower` if given."""
    whole = [abs(s.amplitudes[upper] / (s.amplitudes[lower] if lower else 1.0)) for s in sines]
    return whole, [np.abs(s.cycles[upper] / (s.cycles[lower] if lower else 1.0)) for s in sines]


def _width_by(sine: Sine, phase: float, half: float) -> float:
    """Change of the loop's width [m] by a phase error of +-`half` [rad]; of second order near a quarter turn."""
    ends = np.abs(np.sin(phase + half * np.array([-1, 0, 1])))
    return 2 * abs(sine.amplitudes["displacement"]) * float(np.abs(ends - ends[1]).max())


def _phases(sines: Sequence[Sine], upper: str, lower: str) -> Values:
    """Phase [rad] of `upper` over `lower`, as a whole and by cycle, corrected for the delays of both."""
    whole, by_cycle = [], []
    for sine in sines:
        turn = np.exp(1j * sine.turn(upper, lower))
        ratio = sine.amplitudes[upper] / sine.amplitudes[lower] * turn
        middle = float(np.angle(ratio))
        whole.append(middle)
        by_cycle.append(middle + np.angle(sine.cycles[upper] / sine.cycles[lower] * turn / ratio))
    return whole, by_cycle


def _over_frequency(sines: Sequence[Sine]) -> list[Finding]:
    """Impure sines, and the possible delay of the pressure."""
    lines = []
    for name in MOVED:
        left = [sine.left[name] for sine in sines]
        if left and max(left) > NO_SINE:
            text = f"{name} is no pure sine: {min(left):.0%} to {max(left):.0%} is left by the first harmonic"
            lines.append(Finding("note", f"{text}, and only the harmonic is reported"))
    slowest = min(sines, key=lambda sine: sine.frequency, default=None)
    if slowest is not None and abs(slowest.amplitudes["pressure"]) > (1 + AMPLIFIED) * slowest.drive:
        times, at = abs(slowest.amplitudes["pressure"]) / slowest.drive, show(slowest.frequency, "frequency", 3)
        text = f"at {at} the pressure swings {times:.3g} times as far as its command, which no regulator does so slowly"
        lines.append(Finding("doubt", f"{text}: the unit or the scale of the gauge, or of the command, is wrong"))
    most = max((sine.late["pressure"][1] for sine in sines), default=0.0)
    if len(sines) > 2 and most > 0:
        fastest = max(sine.omega for sine in sines)
        text = (
            f"the pressure may be up to {show(most, 'time', 2)} older than its stamps, worth "
            f"{fastest * most:.2f} rad at the highest frequency: no damping is derived from these phases"
        )
        lines.append(Finding("doubt", text))
    return lines


def _loop(sine: Sine) -> Trace:
    """The last cycle, measured and as its first harmonic."""
    last = sine.t >= sine.t[-1] - 1 / sine.frequency
    t, P, x = sine.t[last], sine.P[last], sine.x[last]
    X = sine.amplitudes["displacement"]
    model = float(np.mean(sine.x)) + np.real(X * np.exp(1j * sine.omega * t))
    title = f"Contraction over pressure at {show(sine.frequency, 'frequency', 3)}, the last cycle"
    columns = {"pressure": P, "displacement": x, "model": model}
    quantities = {"pressure": "pressure", "displacement": "length", "model": "length"}
    name, marks = f"pressure-loop-{sine.frequency:.3g}Hz", {"frequency": sine.frequency}
    return Trace(name, "pressure-loop", title, columns, quantities, marks)


def _bode(sines: Sequence[Sine]) -> Trace:
    """Gain and phase of contraction over measured pressure."""
    ratios = [
        s.amplitudes["displacement"] / s.amplitudes["pressure"] * np.exp(1j * s.turn("displacement", "pressure"))
        for s in sines
    ]
    columns = {
        "frequency": np.array([s.frequency for s in sines]),
        "gain": np.array([1 / abs(ratio) for ratio in ratios]),
        "phase": np.angle(ratios),
    }
    title = "Pressure per contraction, and phase of contraction against pressure"
    quantities = {"frequency": "frequency", "gain": "gain", "phase": "angle"}
    return Trace("pressure-bode", "pressure-bode", title, columns, quantities)
