"""What a tuning rule is: its name, the form of controller that it is for, its source, and its formula."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, nan

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
