"""Whether isometric tests have the assumed form: no drift, slip, yielding end or late force.

Each departure is sized by quantities that do not depend on the values, and subtracted from the forces at that size; the
change of the values is its effect. A zero error of cell or gauge is subtracted where nothing else explains the reading
at rest, and otherwise left as uncertainty: a muscle shorter than its nominal length has no force without pressure, and
no gauge pressure is below 0. Works on cells of tests; computes no estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from pmabench.analysis.imported import in_time
from pmabench.analysis.shared import student
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.isometric_lines import Groups, Test, line_of
from pmabench.analysis.shared.samples import ends, noise_of
from pmabench.analysis.shared.trials import grouped, session_of
from pmabench.base.quantities import show
from pmabench.kinds.isometric_pressurisation.curve import REST, Cell, pulling
from pmabench.store.analyses.results import Finding
from pmabench.store.records import Array

FALSE_ALARMS = 0.005
"""Share of correct runs in which a drift or a slip is called significant, for each of the two."""
SWINGS = 0.3
"""Time after a ramp in which the force may still settle [s]."""
AROUND = 1.0
"""Range around the end of the ramp up in which a late force shows [s]."""
SMOOTH = 0.2
"""Pressure and force are means over this time before one is compared with the slope of the other [s]."""
WITHOUT = 0.02
"""Share of the highest pressure below which the muscle counts as vented."""
STRETCHED = 1e-4
"""A muscle that is longer than its nominal length by this is stretched [m]."""
DRIFTS = 6.0
"""Difference of the cell's zero between files, in the noise of one sample, from which on it is significant."""
DRIFT = "drift of the force cell"
YIELDS = 1e-5
"""Smallest change of the displacement that counts as a yielding end [m]."""


@dataclass(frozen=True, eq=False)
class Departure:
    """A possible error of the tests."""

    name: str
    part: str
    """Field of `Parts`."""
    force: Callable[[Test], Array]
    """Force that it adds to a test at the largest possible size [N], shape of the test's samples."""
    seen: bool
    reason: str
    moves: bool = False
    """Whether it is the muscle that moves, and not the cell that reads another force."""


def departures(cells: Sequence[Cell]) -> list[Departure]:
    """Departures that these tests can size: drift of the cell, slip of a mount, yielding driven end."""
    K = _stiffness(cells)
    drift, slope = _drift(cells)
    return [one for one in (drift, _slip(cells, K, slope), _gives_way(cells, K)) if one is not None]


def late(cells: Sequence[Cell]) -> tuple[float, float]:
    """Delay of the force behind the pressure [s] and its standard error, from the ends of the ramps up.

    F = a + m (P - delay dP/dt): while the pressure rises the force is low, and it catches up when the ramp ends, where
    hysteresis does not change. NaN where there are too few samples. Creep has the same effect.
    """
    found = []
    for test in (test for cell in cells if cell.pooled is not None for test in cell.tests):
        turn = next((ends(c) for c in test.trial.commands if c.phase == "fill" and c.data.get("rate")), None)
        if turn is None:
            continue
        trial = test.trial
        near = (np.abs(trial.t - turn) <= AROUND) & trial.usable
        t, P, F = trial.t[near], trial.channels["pressure"][near], trial.channels["force"][near]
        width = max(3, round(SMOOTH / float(np.median(np.diff(t))))) if len(t) > 20 else len(t) + 1
        if len(t) < 4 * width or not np.isfinite([P, F]).all():
            continue
        window = np.ones(width) / width
        P, F, t = (np.convolve(values, window, mode="valid") for values in (P, F, t))
        design = np.column_stack([np.ones_like(P), P - P.mean(), np.gradient(P, t)])
        size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        _, m, delayed = np.linalg.lstsq(design / size, F, rcond=None)[0] / size
        if m > 0:
            found.append(-delayed / m)
    if len(found) < 3:
        return float("nan"), float("nan")
    return float(np.mean(found)), float(np.std(found, ddof=1)) / sqrt(len(found))


def _stiffness(cells: Sequence[Cell]) -> dict[float, tuple[Array, Array]]:
    """K [N/m] over pressure [Pa] at each contraction, from the forces of its neighbours; empty with one contraction."""
    known = [cell for cell in cells if np.isfinite(cell.mean.force).sum() > 1]
    places = np.array([float(cell.place.mean()) for cell in known])
    if len(known) < 2 or np.min(np.diff(places)) <= 0:
        return {}
    P = known[0].mean.P
    forces = []
    for cell in known:
        there = np.isfinite(cell.mean.force)
        forces.append(np.interp(P, cell.mean.P[there], cell.mean.force[there]))
    K = np.maximum(0.0, -np.gradient(np.array(forces), places, axis=0))
    return {cell.contraction: (P, row) for cell, row in zip(known, K, strict=True)}


Row = tuple[Test, tuple[object, ...], Cell, Array]
"""A test, the key that its repeats share, its cell, and its mean of both branches in each bin [N]."""


def _rows(cells: Sequence[Cell]) -> list[Row]:
    """The tests in the order in which they were done."""
    every = [(test, cell, each) for cell in cells for test, each in zip(cell.tests, cell.mean.each, strict=True)]
    runs = in_time({test.run.id: test.run for test, _, _ in every}.values())
    place = {run.id: number for number, run in enumerate(runs)}
    every.sort(key=lambda row: (place[row[0].run.id], row[0].t[0]))
    return [(t, (t.run.id, cell.contraction, t.trial.point.get("side", 0.0)), cell, each) for t, cell, each in every]


def _off(values: Array, groups: Sequence[object]) -> Array:
    """Values minus the mean of their group, along the first axis."""
    names = {name: place for place, name in enumerate(dict.fromkeys(groups))}
    group = np.array([names[name] for name in groups])
    count = np.bincount(group)
    sums = np.zeros((len(count), *values.shape[1:]))
    np.add.at(sums, group, values)
    means = sums / count.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(values - means[group])


def scatter_of(cells: Sequence[Cell]) -> float | None:
    """Half width of the 95 % interval of one test, as a share of its force, by all repeats; None with few of them."""
    rows = [row for row in _rows(cells) if row[2].low is not None]
    shares = []
    for _, _, cell, each in rows:
        there = np.isfinite(each) & np.isfinite(cell.mean.force) & (cell.mean.P >= (cell.low or 0.0))
        shares.append(float(each[there].sum() / cell.mean.force[there].sum()) if there.any() else 1.0)
    groups = [group for _, group, _, _ in rows]
    freedom = len(rows) - len(set(groups))
    if freedom < 2:
        return None
    return float(student.ppf(0.975, freedom)) * sqrt(float(np.sum(_off(np.array(shares), groups) ** 2)) / freedom)


def at_rest(test: Test, channel: str = "force") -> list[tuple[int, float, float]]:
    """Rests before (0) and after (1) the ramps, without pressure: which one, its middle time [s], mean reading [SI]."""
    trial, found = test.trial, []
    ramps = {c.phase: c for c in trial.commands if c.kind == "ramp" and c.data.get("rate")}
    if not {"fill", "empty"} <= set(ramps):
        return []
    begin, over = ramps["fill"].t, ends(ramps["empty"])
    P, read = trial.channels["pressure"], trial.channels[channel]
    for which, (low, high) in enumerate(((begin - REST + SWINGS, begin), (over + SWINGS, over + REST))):
        rows = (trial.t >= low) & (trial.t < high) & trial.usable & np.isfinite(read)
        if rows.sum() > 2 and float(P[rows].mean()) < WITHOUT * float(test.P.max()):
            found.append((which, 0.5 * (low + high), float(read[rows].mean())))
    return found


def gone_since(test: Test) -> float | None:
    """Change of the cell's reading from before to after the ramps [N]; None for a muscle that may pull without
    pressure.
    """
    reads = {which: read for which, _, read in at_rest(test)}
    return reads[1] - reads[0] if len(reads) == 2 and test.trial.point["contraction"] > -STRETCHED else None


def _zeros(ordered: Sequence[Row]) -> Departure | None:
    """For tests in one file each: the zero of the cell in each file, since a muscle that is not stretched pulls nothing
    without pressure; None with fewer than two.
    """
    able = [(test, at_rest(test)) for test, _, cell, _ in ordered if cell.contraction > -STRETCHED]
    zeros = {test: float(np.mean([read for _, _, read in rests])) for test, rests in able if rests}
    if len(zeros) < 2:
        return None
    low, high = min(zeros.values()), max(zeros.values())
    noise = max(noise_of(test.F) for test in zeros)
    reason = (
        f"at rest without pressure the force cell reads from {show(low, 'force', 2)} to {show(high, 'force', 2)}: its "
        "zero drifts from file to file. Let the cell warm up, and measure again"
    )
    known = [i for i, row in enumerate(ordered) if row[0] in zeros]
    nearest = {}
    for number, row in enumerate(ordered):
        nearest[row[0]] = zeros[ordered[min(known, key=lambda i: abs(i - number))][0]]

    def force(test: Test) -> Array:
        return np.full(len(test.t), nearest[test])

    return Departure(DRIFT, "drift", force, high - low > DRIFTS * noise, reason)


def _drift(cells: Sequence[Cell]) -> tuple[Departure | None, float]:
    """Drift of the cell's zero from its readings at rest before and after the ramps, if they allow it; and its slope
    [N/s].
    """
    times, readings, groups = [], [], []
    ordered = _rows(cells)
    for test, group, _, _ in ordered:
        for which, middle, read in at_rest(test):
            times.append(middle)
            readings.append(read)
            groups.append((*group, which))
    if len({row[0].run.id for row in ordered}) == len(ordered) > 1:
        return _zeros(ordered), 0.0
    if len(times) < 3:
        return None, 0.0
    t, z = (_off(np.array(values), groups) for values in (times, readings))
    freedom = len(times) - len(set(groups))
    power = float(t @ t)
    if freedom < 2 or power <= 0:
        return None, 0.0
    slope = float(t @ z) / power
    error = sqrt(float(np.sum((z - slope * t) ** 2)) / (freedom - 1) / power)
    seen = abs(slope) > float(student.ppf(1 - FALSE_ALARMS / 2, freedom - 1)) * error
    most = abs(slope) + 2 * error
    first, whole = min(times), max(times) - min(times)
    reason = (
        f"the force cell drifts: at rest it reads {show(abs(slope) * whole, 'force', 2)} "
        f"{'more' if slope > 0 else 'less'} at the end of the run. Let the cell warm up, and measure again"
    )

    def force(test: Test) -> Array:
        return np.asarray(np.copysign(most, slope) * (test.t - first))

    return Departure(DRIFT, "drift", force, seen, reason), slope


def _slip(cells: Sequence[Cell], K: dict[float, tuple[Array, Array]], slope: float) -> Departure | None:
    """A mount that slipped before one of the tests: later forces of repeats differ by K times a length. None if not
    significant.
    """
    rows = [row for row in _rows(cells) if row[2].contraction in K and row[2].low is not None]
    pulls, stiff = [], []
    for test, _, cell, each in rows:
        there = np.isfinite(each) & (cell.mean.P >= (cell.low or 0.0))
        pulls.append(float(each[there].mean() - slope * test.t.mean()) if there.any() else np.nan)
        stiff.append(float(np.interp(cell.mean.P[there], *K[cell.contraction]).mean()) if there.any() else np.nan)
    known = np.isfinite(pulls)
    rows = [row for row, one in zip(rows, known, strict=True) if one]
    F, k = np.array(pulls)[known], np.array(stiff)[known]
    if len(rows) < 4:
        return None
    groups = [group for _, group, _, _ in rows]
    runs = np.array([hash(row[0].run.id) for row in rows])
    order = np.arange(len(rows))
    later = [(order >= at) & (runs == runs[at]) for at in order[1:] if runs[at] == runs[at - 1]]
    steps = np.array(later, dtype=float).T
    y, freedom = _off(F, groups), len(F) - len(set(groups))
    if freedom < 4 or not steps.size:
        return None
    columns = _off(steps * k[:, None], groups)
    power = np.sum(columns**2, axis=0)
    usable = power > 1e-6 * power.max()
    size = np.where(usable, columns.T @ y / np.where(usable, power, 1.0), 0.0)
    left = float(y @ y) - size**2 * power
    best = int(np.argmin(left))
    error = sqrt(max(float(left[best]), 0.0) / (freedom - 2) / float(power[best]))
    seen = abs(size[best]) > float(student.ppf(1 - 0.5 * FALSE_ALARMS / steps.shape[1], freedom - 2)) * error
    if not seen:
        return None
    most = float(np.copysign(abs(size[best]) + 2 * error, size[best]))
    first = [row[0] for row, after in zip(rows, steps[:, best], strict=True) if after]
    reason = (
        f"from test {first[0].name} on the muscle pulls as if it were held {show(abs(float(size[best])), 'length', 2)} "
        f"{'longer' if size[best] > 0 else 'shorter'} than the displacement says: a mount that slips, or a muscle that "
        "settles. Mend it and measure again"
    )
    names = {test.name for test in first}
    at = {test.name: cell.contraction for test, _, cell, _ in rows}

    def force(test: Test) -> Array:
        if test.name not in names:
            return np.zeros(len(test.P))
        return np.asarray(most * np.interp(test.P, *K[at[test.name]]) * (test.F > 0))

    return Departure("slip of a mount", "drift", force, True, reason, moves=True)


def _gives_way(cells: Sequence[Cell], K: dict[float, tuple[Array, Array]]) -> Departure | None:
    """A driven end whose displacement moves while the muscle pulls; None if it does not."""
    at = {test.name: cell.contraction for cell in cells if cell.contraction in K for test in cell.tests}
    moves = [0.0]
    for cell in cells:
        for test in cell.tests:
            blocks = [part for part in np.array_split(test.x[pulling(test)], 20) if len(part)]
            if test.name in at and np.isfinite(test.x).all() and len(blocks) == 20:
                noise = noise_of(test.x) / sqrt(len(blocks[0]))
                moves.append(max(0.0, float(np.ptp([part.mean() for part in blocks])) - 6 * noise))
    if max(moves) < YIELDS:
        return None
    reason = (
        f"it is not isometric: the driven end moves by up to {show(max(moves), 'length', 2)} while the muscle pulls. "
        "Hold it more stiffly"
    )

    def force(test: Test) -> Array:
        if test.name not in at or not np.isfinite(test.x).all():
            return np.zeros(len(test.P))
        off = np.where(pulls := pulling(test), test.x - test.x[pulls].mean(), 0.0)
        return np.asarray(-np.interp(test.P, *K[at[test.name]]) * off)

    return Departure("motion of the driven end", "method", force, True, reason, moves=True)


USED = 0.5
"""Share of a zero's declared uncertainty from which on the reading at rest is the better estimate."""
CELL, GAUGE = "zero of the force cell", "zero of the gauge"
CHANNELS = {"force": "force cell", "pressure": "gauge"}
AT_NOMINAL = (
    "at rest without pressure the force cell reads {} at the nominal length: its zero, or tension in the muscle. The "
    "intervals hold both. Take the zero of the cell, or test a shorter length as well"
)
NOT_VENTED = (
    "vented, the gauge reads {}: its zero, or a regulator that does not vent. The intervals hold both. Vent the muscle "
    "and take the zero of the gauge"
)


def zeroed(groups: Groups, scales: Scales) -> tuple[Groups, list[Departure], list[Finding]]:
    """The tests with forces and pressures corrected for their zeros; readings that may be a zero or real; findings.

    Zeros are per session. One that is within noise, or small compared with the calibration's uncertainty, is not
    corrected.
    """
    known = {name: scales.offsets.get(name, 0.0) for name in CHANNELS}
    every = [test for tests in groups.values() for test in tests]
    slack = _beyond(every, STRETCHED)
    taken: dict[str, dict[str, float]] = {name: {} for name in CHANNELS}
    for session, mine in grouped(every, lambda test: session_of(test.run)).items():
        short = _beyond(mine, STRETCHED) or slack
        taken["force"][session] = _level(short, "force", USED * known["force"])
        taken["pressure"][session] = min(0.0, _level(mine, "pressure", USED * known["pressure"]))
    largest = {name: max(zeros.values(), key=abs, default=0.0) for name, zeros in taken.items()}
    said = [_said(name, zero, known[name]) for name, zero in largest.items() if zero]
    opened = []
    if F := _level([] if slack else _beyond(every, -STRETCHED), "force", known["force"]):
        opened.append(Departure(CELL, "calibration", lambda test: np.full(len(test.t), F), True, ""))
        said.append(Finding("doubt", AT_NOMINAL.format(show(F, "force", 2))))
    if (P := _level(every, "pressure", known["pressure"])) > 0:
        opened.append(Departure(GAUGE, "calibration", lambda test: -P * _slope(test), True, "", moves=True))
        said.append(Finding("doubt", NOT_VENTED.format(show(P, "pressure", 2))))
    moved = {x: [_moved(test, taken) for test in tests] for x, tests in groups.items()}
    return moved, opened, said


def _beyond(tests: Sequence[Test], least: float) -> list[Test]:
    """The tests at contractions above `least` [m]."""
    return [test for test in tests if test.trial.point["contraction"] > least]


def _level(tests: Sequence[Test], name: str, known: float) -> float:
    """Reading of a channel in all rests of some tests [SI]; the one nearest to 0 if it varies.

    0 where it is within noise or `known`, or does not occur both before and after the ramps: then it may be hysteresis.
    """
    rests = [(which, read) for test in tests for which, _, read in at_rest(test, name)]
    reads = [read for _, read in rests]
    if len({which for which, _ in rests}) < 2 or min(reads) <= 0 <= max(reads):
        return 0.0
    noise = max(noise_of(test.F if name == "force" else test.P) for test in tests)
    level = float(np.median(reads)) if np.ptp(reads) < noise else min(reads, key=abs)
    return level if abs(level) > max(noise, known) else 0.0


def _slope(test: Test) -> Array:
    """dF/dP of a test [N/Pa] at its samples: one value where it pulls, 0 elsewhere."""
    rows = pulling(test)
    line = line_of(test.P[rows], test.F[rows])
    return np.where(rows, line.m if line else 0.0, 0.0)


def _moved(test: Test, taken: dict[str, dict[str, float]]) -> Test:
    """A test with its zeros subtracted."""
    F, P = (taken[name][session_of(test.run)] for name in ("force", "pressure"))
    if not F and not P:
        return test
    channels = test.trial.channels
    channels = {**channels, "force": channels["force"] - F, "pressure": channels["pressure"] - P}
    return replace(test, trial=replace(test.trial, channels=channels), F=test.F - F, P=test.P - P)


def _said(name: str, zero: float, known: float) -> Finding:
    """Finding that a zero was subtracted, and whether it exceeds its calibration."""
    text = f"at rest without pressure the {CHANNELS[name]} reads {show(zero, name, 2)}: taken as its zero and taken off"
    if not 0 < known < abs(zero):
        return Finding("note", f"{text}. Take the zero before the tests")
    most = f"its calibration says at most {show(known, name, 2)}"
    return Finding("doubt", f"{text}; {most}. Take the zero before the tests, and calibrate it again")
