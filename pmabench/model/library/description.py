"""What the library says of each model: inputs, outputs, domain, source, reference values; knows no model and no units.

A model is a pure function of named values, all SI, arrays broadcast against each other, decorated with `described`:
every call is checked against the domain before anything is computed, and refused with the reason.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, ParamSpec

import numpy as np
from numpy.typing import ArrayLike

from pmabench.model.curve import Array

FAMILIES = (
    "static force",
    "length",
    "three-element",
    "modified Daerden",
    "chamber",
    "regulator",
    "friction and hysteresis",
    "load",
    "composition",
    "joint",
    "platform",
    "loop",
)
"""The families in the order in which they are listed."""
Values = dict[str, Array]
"""The outputs of a model by name [SI]."""
P = ParamSpec("P")
INF = math.inf


ROUNDING = 1e-12
"""Share of an end of a domain that rounding of units may be worth."""


@dataclass(frozen=True)
class Parameter:
    """An input of a model. `quantity` is the name of a physical quantity, `count` for a pure number."""

    name: str
    symbol: str
    quantity: str
    value: float | str
    """Reference value [SI], taken where nothing else is given; `origin` says where it is from."""
    meaning: str
    low: float = -INF
    high: float = INF
    reason: str = ""
    """Why it ends there, as half a sentence."""
    origin: str = "example"
    above: bool = False
    """Whether `low` itself is outside."""
    choices: tuple[str, ...] = ()
    """The names to choose from; then `quantity` is empty and `value` one of them."""

    def holds(self, value: float) -> bool:
        """Whether a finite value [SI] lies in the domain, with room for rounding of units."""
        low, high = self.low - ROUNDING * abs(self.low), self.high + ROUNDING * abs(self.high)
        return (value > self.low if self.above else not value < low) and not value > high


@dataclass(frozen=True)
class Output:
    """What a model gives: SI values of the quantity."""

    name: str
    symbol: str
    quantity: str
    meaning: str


@dataclass(frozen=True)
class Reference:
    """A number that was printed or computed independently, and the inputs that lead to it (others as by default)."""

    output: str
    printed: str
    """As it is printed, for instance "0.3856": the last digit counts as rounded."""
    unit: str
    """Unit of `printed`, in words."""
    scale: float
    """SI value of that unit."""
    source: str
    at: Mapping[str, float | str] = field(default_factory=dict)

    @property
    def value(self) -> float:
        """The printed value [SI]."""
        return float(self.printed) * self.scale

    @property
    def rounding(self) -> float:
        """Half a unit of the last printed digit [SI]."""
        mantissa, _, power = self.printed.lower().partition("e")
        return 0.5 * 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2])) * self.scale


@dataclass(frozen=True)
class Model:
    """A model of the library."""

    name: str
    family: str
    title: str
    equation: tuple[str, ...]
    source: str
    parameters: tuple[Parameter, ...]
    outputs: tuple[Output, ...]
    references: tuple[Reference, ...]
    notes: tuple[str, ...]
    """What one should know: where the print is wrong, what is not refused and why."""
    function: Callable[..., Values]
    unchecked: Callable[..., Values]
    """The same without a look at the domains of single inputs, for a fit that keeps to them itself."""
    fitted: tuple[str, ...] = ()
    """The inputs that a fit to measurements takes as unknown, where nothing else is said."""

    def evaluate(self, values: Mapping[str, ArrayLike | str] | None = None) -> Values:
        """The outputs [SI] for `values` [SI] by parameter name, the others at their reference values.

        Raises
        ------
        OutsideDomain
            Where the model does not hold.
        KeyError
            For a name that is no parameter.
        """
        given = dict(values or {})
        unknown = [name for name in given if name not in {p.name for p in self.parameters}]
        if unknown:
            raise KeyError(unknown[0])
        return self.function(**{p.name: given.get(p.name, p.value) for p in self.parameters})


@dataclass(frozen=True)
class Refusal:
    """Why a value is refused: `value`, `low` and `high` are SI, and NaN where they do not say it."""

    name: str
    reason: str
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    above: bool = False

    def __str__(self) -> str:
        """The sentence, in SI."""
        if math.isnan(self.value):
            return f"{self.name}: {self.reason}"
        if math.isnan(self.low):
            return f"{self.name} = {self.value:.6g} (SI): {self.reason}"
        ends = f"{'above ' if self.above else ''}{self.low:.6g} to {self.high:.6g}"
        return f"{self.name} = {self.value:.6g} (SI) is outside {ends}" + (f": {self.reason}" if self.reason else "")


class OutsideDomain(ValueError):
    """Inputs for which a model does not hold; all refusals at once."""

    def __init__(self, *refusals: Refusal) -> None:
        self.refusals = refusals
        super().__init__("; ".join(map(str, refusals)))


def refuse(name: str, reason: str, broken: ArrayLike = True, value: ArrayLike | None = None) -> None:
    """Refuse input `name` where `broken` is true anywhere; with the `value` [SI] at the first such place."""
    if not np.any(broken):
        return
    if value is None:
        raise OutsideDomain(Refusal(name, reason))
    where, values = np.broadcast_arrays(broken, np.asarray(value, dtype=np.float64))
    raise OutsideDomain(Refusal(name, reason, float(values[where].flat[0])))


MODELS: dict[str, Model] = {}
"""Every model by name."""


def described(
    name: str,
    family: str,
    title: str,
    *,
    equation: tuple[str, ...],
    source: str,
    parameters: tuple[Parameter, ...],
    outputs: tuple[Output, ...],
    references: tuple[Reference, ...],
    notes: tuple[str, ...] = (),
    fitted: tuple[str, ...] = (),
) -> Callable[[Callable[P, Values]], Callable[P, Values]]:
    """Put a function into the library: its calls are checked against the domains of `parameters`."""

    def enter(function: Callable[P, Values]) -> Callable[P, Values]:
        known = [p.name for p in parameters]
        own = inspect.signature(function).parameters.values()
        named = [p.name for p in own if p.kind is not p.VAR_POSITIONAL]  # `*rest` takes all others in their order
        as_described = named == (known if len(named) == len(own) else known[: len(named)])
        if not as_described or name in MODELS or family not in FAMILIES or set(fitted) - set(known):
            raise TypeError(f"{name}: known already, of no family, or not described as its function is")

        @wraps(function)
        def checked(*args: P.args, **kwargs: P.kwargs) -> Values:
            values = {**dict(zip(known, args, strict=False)), **kwargs}
            if len(args) + len(kwargs) != len(known) or values.keys() != set(known):
                raise TypeError(f"{name} takes {', '.join(known)}, each once")
            check(parameters, values)
            return unchecked(**values)

        def unchecked(**values: Any) -> Values:
            inputs: Any = [values[p.name] if p.choices else np.asarray(values[p.name], np.float64) for p in parameters]
            with np.errstate(all="ignore"):
                found = function(*inputs)  # type: ignore[call-arg]
            return {key: np.asarray(value, dtype=np.float64) for key, value in found.items()}

        MODELS[name] = Model(
            name, family, title, equation, source, parameters, outputs, references, notes, checked, unchecked, fitted
        )
        return checked

    return enter


def check(parameters: Sequence[Parameter], values: Mapping[str, Any]) -> None:
    """Raise OutsideDomain with every input that is not finite, not among the choices or out of its range."""
    refusals = []
    for p in parameters:
        value = values[p.name]
        if p.choices:
            if value not in p.choices:
                refusals.append(Refusal(p.name, f'"{value}" is none of {", ".join(p.choices)}'))
            continue
        if isinstance(value, float):
            least = most = value
        elif np.size(value):
            least, most = float(np.min(value)), float(np.max(value))
        else:
            continue
        if not (math.isfinite(least) and math.isfinite(most)):
            refusals.append(Refusal(p.name, "a finite number is expected"))
        elif not p.holds(least) or not p.holds(most):
            array = np.asarray(value, dtype=np.float64)
            first = next(one for one in array.flat if not p.holds(one))
            refusals.append(Refusal(p.name, p.reason, float(first), p.low, p.high, p.above))
    if refusals:
        raise OutsideDomain(*refusals)
