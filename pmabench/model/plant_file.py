"""A plant that was described in a file, from its plain numbers; knows no file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pmabench.model.air import Air
from pmabench.model.curve import Curve
from pmabench.model.hysteresis import Hysteresis
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.presets import Setup
from pmabench.model.regulator import Regulator
from pmabench.model.sensors import Noise


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
    from pmabench.model.contractor_muscle import ContractorMuscle  # needs the library of models, as below

    names = ("name", "length", "radius", "braid_angle", "threshold")
    low, high = numbers["reach"]
    return Setup(ContractorMuscle(**{name: numbers[name] for name in names}, reach=(low, high)), regulator, noise, lag)


def _daerden(numbers: Mapping[str, Any], regulator: Regulator, noise: Noise, lag: float) -> Setup:
    from pmabench.model.daerden_muscle import DaerdenMuscle  # needs the library of models, which needs the presets

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
