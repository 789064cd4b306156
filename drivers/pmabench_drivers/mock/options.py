"""The options of the mock bench as a bench file gives them; imports nothing heavy, knows no plant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from pmabench.base.errors import DeviceError, did_you_mean
from pmabench.model.overrides import Overrides


@dataclass(frozen=True)
class Faults:
    """What goes wrong, and when [s, bench time]; None for never."""

    burst_at: float | None = None
    """The muscle bursts: pressure falls to 0 within some 10 ms and stays there."""
    pressure_stuck_at: float | None = None
    """The pressure channel repeats one value from then on."""
    nan_at: float | None = None
    """Every measured channel reads NaN; one that gives counts reads its lowest count."""
    gap_at: float | None = None
    """The samples of 20 ms are lost."""
    hang_at: float | None = None
    """Calls do not return until the device is closed."""
    lost_at: float | None = None
    """Calls fail as if the link were cut."""


@dataclass(frozen=True)
class Options:
    """All options; numbers in SI."""

    plant: str = "paper0"
    """`paper0` or `serres2009` (pmabench.model.presets)."""
    preset: str = "bench"
    """`bench`: lag, friction, noise; `ideal`: dead time only."""
    seed: int = 1
    """Seed of the noise."""
    free_end: str = "weights"
    """`weights`: hands place loads; `actuator`: the free end is driven."""
    carriage: float = 2.0
    """Moving mass before a load is placed [kg]."""
    supply: float = 690e3
    """What the channel input `supply` reads [Pa]."""
    actuator_low: float = -10e-3
    """Least contraction that the actuator reaches [m]."""
    actuator_high: float = 90e-3
    """Greatest contraction that the actuator reaches [m]."""
    actuator_speed: float = 0.5
    """Its highest speed [m/s]."""
    actuator_force: float = 1500.0
    """The force at which it stalls [N]."""
    faults: Faults = field(default_factory=Faults)
    overrides: Overrides = field(default_factory=Overrides)
    """Given among the options by their own names."""


TEXT = {"plant", "preset", "free_end", "b_relax"}
CHOICES = {"free_end": ("weights", "actuator"), "preset": ("ideal", "bench"), "plant": ("paper0", "serres2009")}


def read_options(device: str, given: Mapping[str, Any]) -> Options:
    """Options checked by name and kind.

    Raises
    ------
    DeviceError
        For an option that is not known, naming the nearest one, or a value that cannot be.
    """
    own = {item.name for item in fields(Options)} - {"overrides"}
    changes = {item.name for item in fields(Overrides)}
    values: dict[str, Any] = {}
    overrides: dict[str, Any] = {}
    for name, value in given.items():
        if name == "faults":
            values[name] = _faults(device, value)
        elif name in own:
            values[name] = _value(device, name, value)
        elif name in changes:
            overrides[name] = _value(device, name, value)
        else:
            raise DeviceError(device, f'no option "{name}"{did_you_mean(name, own | changes)}')
    return Options(**values, overrides=Overrides(**overrides))


def _faults(device: str, given: Any) -> Faults:
    known = [item.name for item in fields(Faults)]
    if not isinstance(given, Mapping):
        raise DeviceError(device, f"faults are given as {{name: time in s}}, not {given!r}")
    for name in given:
        if name not in known:
            raise DeviceError(device, f'no fault "{name}"{did_you_mean(str(name), known)}')
    return Faults(**{name: _value(device, name, value) for name, value in given.items()})


def _value(device: str, name: str, value: Any) -> Any:
    if name in TEXT:
        allowed = CHOICES.get(name)
        if not isinstance(value, str) or (allowed and value not in allowed):
            raise DeviceError(device, f'option {name}: "{value}"{did_you_mean(str(value), allowed or ())}')
        return value
    if isinstance(value, bool) or not isinstance(value, int | float) or not value == value:
        raise DeviceError(device, f"option {name}: a number in SI is expected, not {value!r}")
    return int(value) if name == "seed" else float(value)
