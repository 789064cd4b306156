"""Plants as plain numbers, as plans and plant files keep them, and back; knows no file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from pmabench.model.air import Air
from pmabench.model.curve import Curve
from pmabench.model.free_air import AirPlant
from pmabench.model.hysteresis import Hysteresis
from pmabench.model.motion import Noise
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.plant import Plant
from pmabench.model.presets import Setup
from pmabench.model.regulator import Regulator


@dataclass(frozen=True)
class Described:
    """A muscle, the regulator before it and the air that it moves, and in words where they come from."""

    muscle: Muscle
    regulator: Regulator
    source: str
    domain: tuple[float, float]
    """Pressures at which the coefficients are known [Pa]; outside they are continued."""
    air: Air | None = None
    """Where the regulator has to move it; None where the pressure does not depend on the motion."""

    def plant(self, force: float, mass: float, pressure: float = 0.0) -> Plant:
        """The muscle at `pressure` [Pa] with a load F_L = `force` [N] of moving `mass` [kg] on its free end."""
        if self.air is not None:
            return AirPlant(self.muscle, self.regulator, self.air, force=force, mass=mass, pressure=pressure)
        return Plant(self.muscle, self.regulator, force=force, mass=mass, pressure=pressure)

    def to_dict(self) -> dict[str, Any]:
        """Plain data: coefficients as polynomials of P, highest power first, joined at breaks (SI)."""
        muscle = {field.name: getattr(self.muscle, field.name) for field in fields(Muscle)}
        return {
            "source": self.source,
            "domain": list(self.domain),
            "regulator": asdict(self.regulator),
            **({} if self.air is None else {"air": asdict(self.air)}),
            **{name: _plain(value) for name, value in muscle.items() if value is not None},
        }

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Described:
        """The inverse of `to_dict`; what the data lack (plans of earlier versions) is as a muscle has it."""
        values = {field.name: _value(field.name, data[field.name]) for field in fields(Muscle) if field.name in data}
        muscle = Muscle(**{"name": str(data["source"]), **values})
        low, high = data["domain"]
        air = Air(**data["air"]) if "air" in data else None
        return cls(muscle, Regulator(**data["regulator"]), str(data["source"]), (float(low), float(high)), air)


def _plain(value: Any) -> Any:
    """A field of a muscle as plain data."""
    if isinstance(value, Curve):
        return {"pieces": [list(piece) for piece in value.pieces], "breaks": list(value.breaks)}
    return asdict(value) if isinstance(value, Friction) else value


def _value(name: str, data: Any) -> Any:
    """The inverse of `_plain`."""
    if name == "friction":
        return Friction(**data)
    if isinstance(data, Mapping):
        pieces = tuple(tuple(float(c) for c in piece) for piece in data["pieces"])
        return Curve(pieces, tuple(float(edge) for edge in data["breaks"]))
    return data if isinstance(data, str) else float(data)


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


def setup_of(numbers: Mapping[str, Any]) -> Setup:
    """The setup of a simulated bench.

    `numbers` are SI; each coefficient is either `points`, pairs of pressure and value, or the arguments of
    `Curve.printed`.
    """
    regulator, noise, lag = Regulator(**numbers["regulator"]), Noise(**numbers["noise"]), float(numbers["follow_lag"])
    if numbers["law"] == "daerden":
        return _daerden(numbers, regulator, noise, lag)
    if numbers["law"] == "contractor":
        return _contractor(numbers, regulator, noise, lag)
    curves = {symbol: _curve(numbers[symbol]) for symbol in ("F_ce", "K", "B_c", "B_r", "tau_r") if symbol in numbers}
    muscle = Muscle(
        name=str(numbers["name"]),
        friction=Friction(**numbers["friction"]),
        length=float(numbers["length"]),
        stop=float(numbers["stop"]),
        diameter=float(numbers.get("diameter", 0.0)),
        braid_angle=float(numbers.get("braid_angle", 0.0)),
        **curves,
    )
    return Setup(muscle, regulator, noise, lag, air=_air(numbers.get("flow"), regulator))


def _curve(given: Mapping[str, Any]) -> Curve:
    if "points" in given:
        pressures, values = zip(*given["points"], strict=True)
        return Curve.through(pressures, values)
    return Curve.printed(*given["pieces"], breaks=given["breaks"], unit=given["unit"], pressure=given["pressure"])


def _contractor(numbers: Mapping[str, Any], regulator: Regulator, noise: Noise, lag: float) -> Setup:
    from pmabench.model.published_muscles import ContractorMuscle  # needs the library of models, as below

    names = ("name", "length", "radius", "braid_angle", "threshold")
    low, high = numbers["reach"]
    return Setup(ContractorMuscle(**{name: numbers[name] for name in names}, reach=(low, high)), regulator, noise, lag)


def _daerden(numbers: Mapping[str, Any], regulator: Regulator, noise: Noise, lag: float) -> Setup:
    from pmabench.model.published_muscles import DaerdenMuscle  # needs the library of models, which needs the presets

    names = ("name", "length", "diameter", "braid_angle", "alpha", "A", "B1", "B2")
    low, high = numbers["reach"]
    muscle = DaerdenMuscle(**{name: numbers[name] for name in names}, reach=(float(low), float(high)))
    hysteresis = None
    if numbers["hysteresis"] is not None:
        loop = numbers["hysteresis"]
        hysteresis = Hysteresis(float(loop["height"]), float(loop["width"]) * muscle.length)
    return Setup(muscle, regulator, noise, lag, hysteresis, _air(numbers["flow"], regulator))


def _air(flow: Mapping[str, Any] | None, regulator: Regulator) -> Air | None:
    if flow is None:
        return None
    from pmabench.model.library.chamber import R  # as above

    kept = {name: float(flow[name]) for name in ("fill", "vent", "polytropic", "atmosphere")}
    return Air(**kept, rT=R * float(flow["temperature"]), leak=regulator.leak)
