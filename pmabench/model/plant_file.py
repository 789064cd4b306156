"""A plant that was described in a file, from its plain numbers; knows no file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pmabench.model.curve import Curve
from pmabench.model.muscle import Friction, Muscle
from pmabench.model.presets import Setup
from pmabench.model.regulator import Regulator
from pmabench.model.sensors import Noise


def setup_of(numbers: Mapping[str, Any]) -> Setup:
    """The setup of a simulated bench.

    `numbers` are SI; each coefficient is either `points`, pairs of pressure and value, or the arguments of
    `Curve.printed`.
    """
    curves = {symbol: _curve(numbers[symbol]) for symbol in ("F_ce", "K", "B_c", "B_r")}
    muscle = Muscle(
        name=str(numbers["name"]),
        friction=Friction(**numbers["friction"]),
        length=float(numbers["length"]),
        stop=float(numbers["stop"]),
        **curves,
    )
    return Setup(
        muscle,
        Regulator(**numbers["regulator"]),
        Noise(**numbers["noise"]),
        float(numbers["follow_lag"]),
    )


def _curve(given: Mapping[str, Any]) -> Curve:
    if "points" in given:
        pressures, values = zip(*given["points"], strict=True)
        return Curve.through(pressures, values)
    return Curve.printed(*given["pieces"], breaks=given["breaks"], unit=given["unit"], pressure=given["pressure"])
