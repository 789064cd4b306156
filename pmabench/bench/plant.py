"""Plant files to the plain numbers that a simulated bench is made of; independent of the bench.

Plain numbers can be sent to another process and kept in a record; `pmabench.model.presets` makes the plant.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import comb, cos, exp, isfinite, sin, sqrt, tan
from pathlib import Path
from typing import Any

from pmabench.base.errors import InvalidFile, Problem, did_you_mean
from pmabench.base.quantities import show
from pmabench.bench.files.plant import LAWS, ContractorFile, DaerdenFile, PlantFile, Polynomial, RealFile, Table
from pmabench.bench.interface import OutputRecord
from pmabench.files.document import Document, Location, check_schema, document_text, read_document, validate
from pmabench.files.quantity import unit_factor

SYMBOLS = {"F_ce": "force", "K": "stiffness", "B_c": "damping", "B_r": "damping", "tau_r": "time"}
"""Coefficient -> quantity."""
LEAST = {"F_ce": 0.0, "K": 1.0, "B_c": 1.0, "B_r": 1.0, "tau_r": 1e-4}
MOST = {"F_ce": 1e6, "K": 1e6, "B_c": 1e7, "B_r": 1e7, "tau_r": 100.0}
"""Range in which each coefficient must lie at all pressures of the plant [SI]."""
JUMP = 0.02
"""Largest jump of a coefficient at a break, as a fraction of its highest value."""
PAPER_2 = 5e5
"""Highest pressure at which the contractors of paper 2 were measured [Pa]."""
AT_REST = 1.0
"""Largest force without pressure that counts as zero [N]."""

Piece = list[float]


@dataclass(frozen=True)
class Plant:
    """A valid plant file: its numbers (SI, and coefficients as printed), and its text."""

    numbers: dict[str, Any]
    text: str
    path: Path

    def beyond(self, outputs: Iterable[OutputRecord]) -> Iterator[str]:
        """A sentence for each pressure output of a bench that may exceed the plant's highest pressure."""
        highest = self.numbers["highest_pressure"]
        for output in outputs:
            if output.quantity == "pressure" and output.high > highest * (1 + 1e-9):
                there = f"this bench may command {show(output.high, 'pressure')} ({output.high_from})"
                yield f"{self.path.name} holds up to {show(highest, 'pressure')}, and {there}; lower the bench's limit"


def read_plant(path: Path) -> Plant:
    """Read a plant file; raises `InvalidFile` with every problem."""
    document = read_document(path)
    return Plant(plant_numbers(document), document_text(document), path)


def plant_numbers(document: Document) -> dict[str, Any]:
    """Input of `pmabench.model.presets.setup_of`; raises `InvalidFile` with every problem."""
    check_schema(PlantFile, document)
    law = document.data.get("law")
    if law is not None and str(law) not in LAWS:
        raise InvalidFile([document.problem(("law",), f'"{law}" is no law of a plant{did_you_mean(str(law), LAWS)}')])
    file = validate(LAWS[str(law or "three-element")], document)
    numbers = file.model_dump(include={"law", *PlantFile.model_fields} - {"schema_", "source"})
    if isinstance(file, DaerdenFile | ContractorFile):
        beyond = _beyond_the_law(document, file) if isinstance(file, DaerdenFile) else _beyond_paper_2(document, file)
        if wrong := list(beyond):
            raise InvalidFile(wrong)
        return {**file.model_dump(exclude={"schema_", "source"}), "reach": list(file.reach)}
    if isinstance(file, RealFile):
        return {**numbers, **_real_numbers(document, file)}
    compilation = _Curves(document, file.highest_pressure)
    given = {symbol: coefficient for symbol in SYMBOLS if (coefficient := getattr(file, symbol)) is not None}
    curves = {symbol: compilation.curve(symbol, coefficient) for symbol, coefficient in given.items()}
    if compilation.problems:
        raise InvalidFile(compilation.problems)
    friction = file.friction.model_dump() if file.friction is not None else {}
    air = file.flow.model_dump() if file.flow is not None else None
    braid = {"diameter": file.diameter or 0.0, "braid_angle": file.braid_angle or 0.0}
    return {**numbers, "stop": file.stop, **curves, "friction": friction, **braid, "flow": air}


def _real_numbers(document: Document, file: RealFile) -> dict[str, Any]:
    """Surface, damping, hysteresis and creep; height 0 and no stop operators if none are given."""
    compilation = _Curves(document, file.highest_pressure)
    curves = {symbol: compilation.curve(symbol, getattr(file, symbol)) for symbol in ("B_c", "B_r")}
    if wrong := [*compilation.problems, *_too_soft(document, file)]:
        raise InvalidFile(wrong)
    none = {"widths": [], "weights": [], "height": 0.0}
    over_x = none
    if file.hysteresis is not None:
        over_x = file.hysteresis.model_dump()
        over_x["extra"] = over_x.pop("first_cycle")
    return {
        "reach": list(file.reach),
        "surface": file.surface.model_dump(),
        **curves,
        "over_x": over_x,
        "over_P": none if file.pressure_hysteresis is None else file.pressure_hysteresis.model_dump(),
        "creep": {"share": 0.0, "times": []} if file.creep is None else file.creep.model_dump(),
    }


def _too_soft(document: Document, file: RealFile) -> Iterator[Problem]:
    """Problems if the force without hysteresis rises with contraction, or exists without pressure.

    The stiffness is linear in P and, if it is curved, an exponential plus a constant in eps: its minimum is in a corner
    of the range.
    """
    surface, highest = file.surface, file.highest_pressure
    line = (1 - exp(-surface.s * surface.span)) / surface.span
    for P in (0.0, highest):
        for eps in file.reach:
            slope = line + surface.bend * (surface.s * exp(-surface.s * eps) - line)
            K = ((surface.A + surface.A_P * P) * slope - surface.C * P) / file.length
            if not K >= (0.0 if P == 0 else LEAST["K"]) - 1e-9:
                there = f"at {show(P, 'pressure')} and {eps:.3g} of the length"
                yield document.problem(("surface",), f"the stiffness is {show(K, 'stiffness', 4)} {there}, below zero")
                return
    if (rest := surface.A + surface.E) > AT_REST:
        text = f"pulls with {show(rest, 'force', 4)} without pressure and contraction; A + E must not be above zero"
        yield document.problem(("surface",), text)


def _beyond_the_law(document: Document, file: DaerdenFile) -> Iterator[Problem]:
    """Problems if the muscle may be driven beyond the range of its law."""
    if file.reach[0] < -0.9 * file.B2:
        pole = f"must stay above {-0.9 * file.B2:.4g}, short of the pole of the rubber term at -B2"
        yield document.problem(("reach", 0), f"{file.reach[0]:.4g} {pole}")
    furthest = 0.98 * (1 - (1 / (3 * cos(file.braid_angle) ** 2)) ** (1 / file.alpha))
    if file.reach[1] > furthest:
        pulls = f"from {furthest:.1%} on the braid does not turn pressure into a pull"
        yield document.problem(("reach", 1), f"{file.reach[1]:.1%} is too far: {pulls}")


def _beyond_paper_2(document: Document, file: ContractorFile) -> Iterator[Problem]:
    """Problems outside the validity of a contractor's formulas (paper 2 eqs. 8-9)."""
    if file.highest_pressure > PAPER_2 * (1 + 1e-9):
        known, given = show(PAPER_2, "pressure"), show(file.highest_pressure, "pressure")
        text = f"paper 2's contractors are known up to {known}, not to {given}"
        yield document.problem(("highest_pressure",), text)
    a, b = 3 / tan(file.braid_angle) ** 2, 1 / sin(file.braid_angle) ** 2
    furthest = (1 - sqrt(b / a)) / (1 + exp(-file.highest_pressure / 1e5))
    if file.reach[1] > furthest:
        pulls = f"from {furthest:.1%} on it does not pull at {show(file.highest_pressure, 'pressure')} either"
        yield document.problem(("reach", 1), f"{file.reach[1]:.1%} is too far: {pulls}")
    if file.reach[0] >= file.reach[1]:
        yield document.problem(("reach",), "the second must lie above the first")


class _Curves:
    """Coefficients over pressure, from 0 to `highest` [Pa]; collects every problem."""

    def __init__(self, document: Document, highest: float) -> None:
        self._document, self._highest = document, highest
        self.problems: list[Problem] = []

    def curve(self, symbol: str, given: Any) -> dict[str, Any]:
        """Arguments of `Curve.printed`: pieces in `unit` over powers of `pressure`; incomplete with a problem."""
        before = len(self.problems)
        if isinstance(given, tuple):
            value = self._si(given, SYMBOLS[symbol], (symbol,))
            curve: dict[str, Any] = {"pieces": [[value]], "breaks": [], "unit": 1.0, "pressure": 1.0}
        elif isinstance(given, Table):
            curve = self._table(symbol, given)
        else:
            curve = self._polynomial(symbol, given)
        if len(self.problems) == before:
            self._check(symbol, curve)
        return curve

    def _fault(self, location: Location, message: str) -> None:
        self.problems.append(self._document.problem(location, message))

    def _si(self, reading: tuple[float, str], quantity: str, at: Location) -> float:
        """A reading in SI; NaN with a problem."""
        try:
            value = reading[0] * unit_factor(reading[1], quantity)
        except ValueError as error:
            self._fault(at, str(error))
            return float("nan")
        if not isfinite(value):
            self._fault(at, f"{reading[0]:g} {reading[1]} is out of all range")
        return value

    def _table(self, symbol: str, given: Table) -> dict[str, Any]:
        at: Location = (symbol, "points")
        points = [
            (self._si(P, "pressure", (*at, i, 0)), self._si(value, SYMBOLS[symbol], (*at, i, 1)))
            for i, (P, value) in enumerate(given.points)
        ]
        for i in range(1, len(points)):
            if points[i][0] - points[i - 1][0] < 1.0:
                self._fault((*at, i, 0), f"the pressures must rise; {show(points[i - 1][0], 'pressure')} is before it")
        if points[0][0] < 0:
            self._fault((*at, 0, 0), "a gauge pressure is not below zero")
        if points[-1][0] < self._highest * (1 - 1e-9):
            self._short((*at, len(points) - 1, 0), points[-1][0])
        if symbol == "F_ce" and points[0][0] > 0:
            points.insert(0, (0.0, 0.0))
        return {"points": [list(point) for point in points]}

    def _short(self, at: Location, high: float) -> None:
        highest = show(self._highest, "pressure")
        self._fault(at, f"ends at {show(high, 'pressure')}, but highest_pressure is {highest}; they must agree")

    def _polynomial(self, symbol: str, given: Polynomial) -> dict[str, Any]:
        before = len(self.problems)
        unit = self._si((1.0, given.unit), SYMBOLS[symbol], (symbol, "unit"))
        pressure = self._si((1.0, given.pressure), "pressure", (symbol, "pressure"))
        if len(self.problems) > before:
            return {}

        def printed(reading: tuple[float, str] | None, at: Location, missing: float) -> float:
            """A pressure in the printed unit; not converted if it is in that unit."""
            if reading is None or reading[1] == given.pressure:
                return missing if reading is None else reading[0]
            return self._si(reading, "pressure", at) / pressure

        breaks = [printed(edge, (symbol, "breaks", i), 0.0) for i, edge in enumerate(given.breaks or [])]
        centre = printed(given.centre, (symbol, "centre"), 0.0)
        scale = printed(given.scale, (symbol, "scale"), 1.0)
        low = high = None
        if given.domain is not None:
            low, high = (printed(end, (symbol, "domain", i), 0.0) for i, end in enumerate(given.domain))
        if len(self.problems) > before:
            return {}
        if not 1.0 <= scale * pressure <= 1e9 or abs(centre * pressure) > 1e9:
            self._fault((symbol, "scale" if given.scale else "centre"), "is no pressure that a polynomial is scaled by")
        self._check_range(symbol, breaks, low, high, pressure)
        if len(self.problems) > before:
            return {}
        pieces = [list(piece) for piece in given.pieces or [given.coefficients or []]]
        if given.centre is not None or given.scale is not None:
            pieces = [_expanded(piece, centre, scale) for piece in pieces]
        if low:
            value = _value(pieces[0], low)
            pieces.insert(0, [0.0, value / low] if symbol == "F_ce" else [value])
            breaks.insert(0, low)
        if not all(isfinite(c * unit / pressure**n) for piece in pieces for n, c in enumerate(piece)):
            self._fault((symbol,), "its numbers are out of all range")
            return {}
        return {"pieces": pieces, "breaks": breaks, "unit": unit, "pressure": pressure}

    def _check_range(
        self, symbol: str, breaks: list[float], low: float | None, high: float | None, pressure: float
    ) -> None:
        """Breaks and domain, in units of `pressure` [Pa], must rise and reach the highest pressure."""
        rising = [0.0 if low is None else low, *breaks]
        for i in range(1, len(rising)):
            if (rising[i] - rising[i - 1]) * pressure < 1.0:
                self._fault((symbol, "breaks", i - 1), "the breaks must rise, within the domain and above 0 kPa")
        if low is not None and high is not None:
            if not 0 <= low < high:
                self._fault((symbol, "domain"), "the lower end first, and none below zero")
            elif high * pressure < self._highest * (1 - 1e-9):
                self._short((symbol, "domain", 1), high * pressure)

    # -- plausibility of a muscle ---------------------------------------------------------------------------------

    def _check(self, symbol: str, curve: dict[str, Any]) -> None:
        """Add a problem unless the curve is plausible at all pressures from 0 to the highest."""
        quantity, least, most = SYMBOLS[symbol], LEAST[symbol], MOST[symbol]
        seen = list(_extremes(curve, self._highest))
        (at_low, low), (at_high, high) = (pick(seen, key=lambda pair: pair[1]) for pick in (min, max))
        slack = 1e-9 * max(abs(high), 1.0)
        if not low >= least - slack:
            text = f"{symbol} falls to {show(low, quantity, 4)} at {show(at_low, 'pressure', 4)}"
            word = "never below zero" if not least else f"at least {show(least, quantity)}"
            hint = f"; {_way_out(curve, self._highest)}" if symbol == "F_ce" else ""
            where = f"from 0 kPa to highest_pressure, {show(self._highest, 'pressure')}"
            self._fault((symbol,), f"{text}; it must be {word} {where}{hint}")
        elif not high <= most:
            text = f"{symbol} is {show(high, quantity, 4)} at {show(at_high, 'pressure', 4)}"
            self._fault((symbol,), f"{text}, more than any muscle has")
        elif symbol == "F_ce" and seen[0][1] > AT_REST:
            text = f"F_ce is {show(seen[0][1], 'force', 4)} without pressure, and the muscle would creep"
            way = 'give the "domain" from which on it holds: below it the force goes on a straight line to 0 N at 0 kPa'
            self._fault((symbol,), f"{text}; {way}")
        for P, left, right in _jumps(curve):
            if 0 < P < self._highest and not abs(right - left) <= JUMP * max(abs(high), abs(low)):
                values = f"{show(left, quantity, 4)} to {show(right, quantity, 4)}"
                self._fault((symbol, "breaks"), f"{symbol} jumps at {show(P, 'pressure', 4)} from {values}")


def _expanded(coefficients: Sequence[float], centre: float, scale: float) -> Piece:
    """Expand a polynomial of (P - centre) / scale into one of P, in exact arithmetic until the final rounding."""
    terms, shift = [Fraction(c) / Fraction(scale) ** n for n, c in enumerate(coefficients)], -Fraction(centre)
    try:
        return [
            float(sum(term * comb(n, k) * shift ** (n - k) for n, term in enumerate(terms[k:], k)))
            for k in range(len(terms))
        ]
    except OverflowError:
        return [float("inf")]


def _value(coefficients: Sequence[float], P: float) -> float:
    value = 0.0
    for coefficient in reversed(coefficients):
        value = value * P + coefficient
    return value


def _turns(coefficients: Sequence[float], low: float, high: float) -> list[float]:
    """Candidates for extremes of the polynomial: the ends, and the zeros of its derivative between them."""
    slope = [n * c for n, c in enumerate(coefficients)][1:]
    if len(slope) < 2:
        return [low, high]
    zeros = [
        right if _value(slope, left) * _value(slope, right) >= 0 else _zero(slope, left, right)
        for left, right in pairwise(_turns(slope, low, high))
    ]
    return sorted({low, *zeros, high})


def _zero(coefficients: Sequence[float], low: float, high: float) -> float:
    """Where the polynomial changes its sign between `low` and `high`."""
    rising = _value(coefficients, high) > 0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if (_value(coefficients, middle) > 0) == rising else (middle, high)
    return high


def _extremes(curve: dict[str, Any], highest: float) -> Iterator[tuple[float, float]]:
    """Pressures [Pa] and values [SI] that include the minimum and maximum between 0 and `highest` [Pa]."""
    if "points" in curve:
        points = curve["points"]
        inside = [(P, value) for P, value in points if P <= highest]
        yield 0.0, points[0][1]
        yield from inside
        yield from points[len(inside) : len(inside) + 1]
        return
    unit, pressure = curve["unit"], curve["pressure"]
    for piece, (low, high) in zip(curve["pieces"], pairwise([0.0, *curve["breaks"], highest / pressure]), strict=True):
        end = min(high, highest / pressure)
        if low <= end:
            yield from ((P * pressure, _value(piece, P) * unit) for P in _turns(piece, low, end))


def _jumps(curve: dict[str, Any]) -> Iterator[tuple[float, float, float]]:
    """Each break [Pa] with the values to its left and right [SI]."""
    for edge, (left, right) in zip(curve.get("breaks", []), pairwise(curve.get("pieces", [])), strict=True):
        yield edge * curve["pressure"], _value(left, edge) * curve["unit"], _value(right, edge) * curve["unit"]


def _way_out(curve: dict[str, Any], highest: float) -> str:
    """Advice on how to write a force that would be negative at low pressure."""
    if "points" in curve:
        return "a muscle cannot push: give 0 N there"
    piece, pressure = curve["pieces"][0], curve["pressure"]
    if not _value(piece, 0.0) < 0 < _value(piece, highest / pressure):
        return "a muscle cannot push"
    zero = _zero(piece, 0.0, highest / pressure) * pressure
    return f"a muscle cannot push: give 0 as a separate piece up to the break at {zero / 1e3:.10g} kPa"
