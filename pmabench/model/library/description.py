"""Description of a model: inputs, outputs, domain, source, reference values; independent of single models.

A model is a pure function of named values, all SI, with broadcasting, decorated with `described`: every call is checked
against the domain before the calculation, and OutsideDomain gives the reason.
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
    "composition",
    "joint",
    "platform",
    "loop",
)
"""The families, in the order of listings."""
Values = dict[str, Array]
"""The outputs of a model by name [SI]."""
P = ParamSpec("P")
INF = math.inf


ROUNDING = 1e-12
"""Relative tolerance at the ends of a domain, for rounding of units."""


@dataclass(frozen=True)
class Parameter:
    """An input of a model. `quantity` is the name of a physical quantity, `count` for a pure number."""

    name: str
    symbol: str
    quantity: str
    value: float | str
    """Default value [SI]; `origin` states its source."""
    meaning: str
    low: float = -INF
    high: float = INF
    reason: str = ""
    """Reason for the limits, as half a sentence."""
    origin: str = "example"
    above: bool = False
    """Whether `low` itself is excluded."""
    choices: tuple[str, ...] = ()
    """Names to choose from; `quantity` is then empty and `value` is one of them."""

    def holds(self, value: float) -> bool:
        """Whether a finite value [SI] is in the domain, within rounding of units."""
        low, high = self.low - ROUNDING * abs(self.low), self.high + ROUNDING * abs(self.high)
        return (value > self.low if self.above else not value < low) and not value > high


@dataclass(frozen=True)
class Output:
    """An output of a model, in SI units of its quantity."""

    name: str
    symbol: str
    quantity: str
    meaning: str


@dataclass(frozen=True)
class Reference:
    """A printed or independently computed number, and the inputs for it (others at their defaults)."""

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
    """Remarks for the user: misprints, and what is not refused and why."""
    function: Callable[..., Values]
    unchecked: Callable[..., Values]
    """The same without a check of the domains of single inputs, for a fit that respects them itself."""
    fitted: tuple[str, ...] = ()
    """Default unknowns of a fit to measurements."""

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
    """Reason why an input is refused; `value`, `low` and `high` are SI, NaN where not applicable."""

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
    """Inputs outside the domain of a model, with all refusals."""

    def __init__(self, *refusals: Refusal) -> None:
        self.refusals = refusals
        super().__init__("; ".join(map(str, refusals)))


def refuse(name: str, reason: str, broken: ArrayLike = True, value: ArrayLike | None = None) -> None:
    """Raise OutsideDomain for the input `name` if `broken` is true anywhere, with the first such `value` [SI]."""
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
    """Decorator that registers a function as a model; its calls are checked against the domains of `parameters`."""

    def enter(function: Callable[P, Values]) -> Callable[P, Values]:
        known = [p.name for p in parameters]
        own = inspect.signature(function).parameters.values()
        named = [p.name for p in own if p.kind is not p.VAR_POSITIONAL]  # `*rest` takes all others, in order
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
