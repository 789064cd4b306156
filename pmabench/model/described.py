"""A free-end muscle with its regulator as plain numbers, as plans keep them, and back; knows no file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pmabench.model.curve import Curve
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.regulator import Regulator

SYMBOLS = ("F_ce", "K", "B_c", "B_r")


@dataclass(frozen=True)
class Described:
    """A muscle and the regulator before it, and in words where both come from."""

    muscle: Muscle
    regulator: Regulator
    source: str
    domain: tuple[float, float]
    """Pressures at which the coefficients are known [Pa]; outside they are continued."""

    def to_dict(self) -> dict[str, Any]:
        """Plain data: coefficients as polynomials of P, highest power first, joined at breaks (SI)."""
        muscle = self.muscle
        return {
            "source": self.source,
            "domain": list(self.domain),
            "length": muscle.length,
            "stop": muscle.stop,
            "friction": asdict(muscle.friction),
            "regulator": asdict(self.regulator),
            **{
                symbol: {"pieces": [list(piece) for piece in curve.pieces], "breaks": list(curve.breaks)}
                for symbol, curve in ((symbol, getattr(muscle, symbol)) for symbol in SYMBOLS)
            },
        }

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Described:
        """The inverse of `to_dict`."""
        curves = {
            symbol: Curve(
                tuple(tuple(float(c) for c in piece) for piece in data[symbol]["pieces"]),
                tuple(float(edge) for edge in data[symbol]["breaks"]),
            )
            for symbol in SYMBOLS
        }
        muscle = Muscle(
            name=str(data["source"]),
            friction=Friction(**data["friction"]),
            length=float(data["length"]),
            stop=float(data["stop"]),
            **curves,
        )
        low, high = data["domain"]
        return cls(muscle, Regulator(**data["regulator"]), str(data["source"]), (float(low), float(high)))


def tabulated_force(P: Sequence[float], F_ce: Sequence[float]) -> Curve:
    """F_ce [N] through points at rising pressures P [Pa], straight lines between them.

    The lines of the ends go on: below to where they reach 0 N, and to 0 N at 0 Pa where they would not by themselves.
    """
    lines: list[tuple[float, ...]] = [_line(P[i], F_ce[i], P[i + 1], F_ce[i + 1]) for i in range(len(P) - 1)] or [
        (F_ce[0] / P[0] if P[0] > 0 else 0.0, 0.0)
    ]
    edges = list(P[1:-1])
    slope, intercept = lines[0]
    if slope > 0 and intercept < 0:
        return Curve(((0.0,), *lines), (-intercept / slope, *edges))
    if P[0] > 0 and len(P) > 1:
        return Curve(((F_ce[0] / P[0], 0.0), *lines), (P[0], *edges))
    return Curve(tuple(lines), tuple(edges))


def _line(P: float, F: float, P_next: float, F_next: float) -> tuple[float, float]:
    slope = (F_next - F) / (P_next - P)
    return slope, F - slope * P
