"""What a tuning rule is (its name, form of controller, source and formula), and which there are.

`all_rules` finds those of this package and of entry points of the group `pmabench.rules`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.metadata import entry_points
from math import inf, nan
from pkgutil import iter_modules

from pmabench.model import rules
from pmabench.model.loop import Controller, Loop


@dataclass(frozen=True)
class Rule:
    """K_p = gain K_u, T_i = integral T_u, T_d = derivative T_u; or what `from_loop` makes of the loop itself."""

    name: str
    form: str
    """`P`, `PI` or `PID`."""
    source: str
    """Paper and equation."""
    gain: float = nan
    integral: float | None = None
    derivative: float | None = None
    from_loop: Callable[[Loop], Controller] | None = None
    """Settings from dead time, lags and gain; raises ValueError for a loop without what the rule needs."""

    @property
    def title(self) -> str:
        """Name and form, for instance `Ziegler-Nichols PI`."""
        return f"{self.name} {self.form}"

    def settings(self, K_u: float, T_u: float, loop: Loop | None = None) -> Controller:
        """The controller in ideal form, from the ultimate gain `K_u` [any unit] and period `T_u` [s], or from the loop.

        Raises ValueError where the rule needs a loop and there is none, or one that it is not for.
        """
        if self.from_loop is None:
            T_i = inf if self.integral is None else self.integral * T_u
            return Controller(self.gain * K_u, T_i, 0.0 if self.derivative is None else self.derivative * T_u)
        if loop is None:
            raise ValueError(f"{self.name} needs the dead time and the lags of the loop")
        return self.from_loop(loop)


GROUP = "pmabench.rules"


@lru_cache(maxsize=1)
def all_rules() -> tuple[Rule, ...]:
    """Every rule; those that need the loop itself come last."""
    names = [module.name for module in iter_modules(rules.__path__) if module.name != "record"]
    found: list[Rule] = []
    for name in sorted(names):
        found += import_module(f"{rules.__name__}.{name}").RULES
    for point in entry_points(group=GROUP):
        brought = point.load()
        found += [brought] if isinstance(brought, Rule) else brought
    return tuple(sorted(found, key=lambda rule: rule.from_loop is not None))


def find(name: str, form: str) -> Rule | None:
    """The rule of a name for a form of controller (`P`, `PI`, `PID`); None where it has none for that."""
    return next((rule for rule in all_rules() if (rule.name, rule.form) == (name, form)), None)
