"""The line through the points of a calibration, its uncertainty (GUM, k = 2) and its file; no bench is touched."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from math import inf, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.base.errors import RecordError, VerdictFailed
from pmabench.base.quantities import QUANTITIES, show
from pmabench.bench.channels import fit_line, read_calibration
from pmabench.bench.interface import Scale

UP, DOWN = "up", "down"
APART = 0.25
"""Readings at one nominal value that differ by more than this fraction of the step to the next are separate points."""
Array = NDArray[Any]


@dataclass(frozen=True)
class Point:
    """One reading: the reference [SI], the mean raw value [device units], the direction `up` or `down`, the cycle."""

    target: float
    reference: float
    raw: float
    way: str
    cycle: int
    noise: float = 0.0
    """Standard deviation of the samples behind `raw` [device units]."""


@dataclass(frozen=True)
class Fit:
    """Line through the points and its uncertainty; all in SI except `points`: (raw, reference) means."""

    scale: Scale
    points: tuple[tuple[float, float], ...]
    residual: float | None
    """Largest distance of a point from the line; None for two points, through which a line always passes."""
    hysteresis: float
    """Largest difference between up and down at one point."""
    repeatability: float
    """Standard deviation of readings at one point, the same way, between cycles; with one cycle between both ways."""
    drift: float
    """Change of the first point from the first to the last cycle; with one cycle from its beginning to its end."""
    reference: float
    """Expanded uncertainty of the reference (k = 2)."""
    expanded: float
    """Expanded uncertainty of a value from this line (k = 2); for two points without any linearity error."""


def fit(points: Sequence[Point], reference: float) -> Fit:
    """The calibration from readings up and down.

    The standard uncertainties are added in quadrature (GUM 5.1.2): reference U/2; largest residual,
    half the hysteresis and half the drift as half widths of rectangular distributions (/ sqrt 3, GUM 4.3.7);
    repeatability. In a single cycle the only repeats are up and down, so hysteresis also counts as scatter: the two
    cannot be separated. Readings at one nominal value are one point unless they are `APART`.
    Raises VerdictFailed if the points do not define a line.
    """
    target, raw, value = (np.array([getattr(p, name) for p in points]) for name in ("target", "raw", "reference"))
    way, cycle = np.array([p.way for p in points]), np.array([p.cycle for p in points])
    places = list(_places(target, value))
    means = sorted(((float(raw[at].mean()), float(value[at].mean())) for at in places), key=lambda mean: mean[1])
    try:
        scale = fit_line([one for one, _ in means], [one for _, one in means])
    except (ValueError, ZeroDivisionError) as error:
        raise VerdictFailed(f"no calibration: {error}") from error
    residual = max(abs(scale.to_si(one) - reference_value) for one, reference_value in means)
    # deviation from the line at each reading: changes of the reference itself do not count
    off = scale.to_si(raw) - value
    ways = [(off[at & (way == UP)], off[at & (way == DOWN)]) for at in places]
    hysteresis = max((abs(float(up.mean() - down.mean())) for up, down in ways if len(up) and len(down)), default=0.0)
    cells = [off[(target == place) & (way == one)] for place, one in dict.fromkeys((p.target, p.way) for p in points)]
    if len(set(cycle)) == 1:
        cells = [off[target == place] for place in np.unique(target)]
    freedom = len(points) - len(cells)  # pooled over points and directions; 0 without repeats
    repeatability = sqrt(sum(float(np.sum((c - c.mean()) ** 2)) for c in cells) / freedom) if freedom else 0.0
    first = target == target[0]
    ends = [float(off[first & (cycle == number)].mean()) for number in (cycle[0], cycle[first][-1])]
    drift = ends[1] - ends[0] if len(set(cycle)) > 1 else float(off[first][-1] - off[first][0])
    squares = (
        (reference / 2) ** 2,
        (residual / sqrt(3)) ** 2,
        (hysteresis / 2 / sqrt(3)) ** 2,
        (drift / 2 / sqrt(3)) ** 2,
        repeatability**2,
    )
    known = residual if len(places) > 2 else None
    return Fit(scale, tuple(means), known, hysteresis, repeatability, drift, reference, 2 * sqrt(sum(squares)))


def step(target: float, targets: Iterable[float]) -> float:
    """Distance from a nominal value to the nearest other one [SI]; inf for a single one."""
    return min((abs(other - target) for other in targets if other != target), default=inf)


def _places(target: Array, value: Array) -> Iterator[Array]:
    """Masks of the readings that make one point of the line: one nominal value, and references close together."""
    for place in np.unique(target):
        at = target == place
        together = float(np.ptp(value[at])) <= APART * step(place, target)
        yield from [at] if together else np.eye(len(target), dtype=bool)[at]


def write_calibration(
    folder: Path,
    channel: str,
    quantity: str,
    raw_unit: str,
    found: Fit,
    *,
    reference: str,
    run: str,
    today: date,
    valid_until: date | None = None,
    sensor_lag: float = 0.0,
) -> Path:
    """Write `folder`/ID.yaml, ID = CHANNEL-DATE (with -2, -3 ... if it exists); read it back as a bench would.

    Raises RecordError if it cannot be written.
    """
    text = "".join(f"{line}\n" for line in _lines(channel, quantity, raw_unit, found, reference, run))
    made: Path | None = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        first = f"{channel.replace('_', '-').upper()}-{today:%Y%m%d}"
        for name in (first, *(f"{first}-{number}" for number in range(2, 100))):
            path = folder / f"{name}.yaml"
            try:
                with path.open("x", encoding="utf-8") as stream:
                    made = path
                    stream.write(f"schema: pmabench.calibration/1\nid: {name}\n{text}date: {today.isoformat()}\n")
                    if valid_until is not None:
                        stream.write(f"valid_until: {valid_until.isoformat()}\n")
                    if sensor_lag:
                        stream.write(f"sensor_lag: {1e3 * sensor_lag:.6g} ms\n")
                    stream.flush()
                    os.fsync(stream.fileno())
            except FileExistsError:
                continue
            if found.residual is not None:  # else it contains ??, which a bench refuses
                read_calibration(path, quantity)
            return path
    except OSError as error:
        if made is not None:
            made.unlink(missing_ok=True)
        raise RecordError(f"{folder}: the calibration cannot be written: {error.strerror or error}") from error
    raise RecordError(f"{folder}: no name is left for a calibration of {channel} of today")


def _lines(channel: str, quantity: str, raw_unit: str, found: Fit, reference: str, run: str) -> Iterator[str]:
    shown = QUANTITIES[quantity]
    yield f"quantity: {quantity}"
    yield f"reference: {json.dumps(reference, ensure_ascii=False)}"
    yield "points:"
    for raw, value in found.points:
        yield f"  - [{raw:.10g} {raw_unit}, {value / shown.scale:.10g} {shown.shown_in}]"
    known = f"{never_less(found.expanded / shown.scale)} {shown.shown_in}"
    if found.residual is None:
        yield f"expanded_uncertainty: ??  # {known}, and what the data sheet says of linearity: two points show no bend"
    else:
        # if both ends of a line are off by U, independently, it is off by sqrt(2) U over its span
        span = max(value for _, value in found.points) - min(value for _, value in found.points)
        yield f"expanded_uncertainty: {known}"
        yield f"gain_uncertainty: {never_less(100 * sqrt(2) * found.expanded / span)} %"
    yield f"# of {channel}, by the run {run}"
    yield "# from " + ", ".join(f"{name} {value}" for name, value in budget(found, quantity, raw_unit)[2:-1])


def never_less(value: float) -> str:
    """Three significant digits, never rounded down."""
    text = f"{value:.3g}"
    return text if float(text) >= value else f"{value * 1.005:.3g}"


def budget(found: Fit, quantity: str, raw_unit: str) -> list[tuple[str, str]]:
    """Components of the uncertainty: pairs of name and value with unit."""
    shown = QUANTITIES[quantity]
    open_ = "not known; without the bend " if found.residual is None else ""
    return [
        ("slope", f"{found.scale.slope:.8g} {shown.unit}/{raw_unit}"),
        ("offset", show(found.scale.offset, quantity)),
        ("largest residual", "not known: two points" if found.residual is None else show(found.residual, quantity, 3)),
        ("hysteresis", show(found.hysteresis, quantity, 3)),
        ("repeatability (1 s)", show(found.repeatability, quantity, 3)),
        ("drift", show(found.drift, quantity, 3)),
        ("reference (k = 2)", show(found.reference, quantity, 3)),
        ("expanded (k = 2)", f"{open_}{never_less(found.expanded / shown.scale)} {shown.shown_in}"),
    ]
