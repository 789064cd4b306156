"""Tuning rules: controller settings from an ultimate gain and period, or from the loop itself.

`all_rules` gives those of the table `RULES` and of entry points of the group `pmabench.rules`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib.metadata import entry_points
from math import inf, nan

from pmabench.model.loop import Controller, Loop


@dataclass(frozen=True)
class Rule:
    """K_p = gain K_u, T_i = integral T_u, T_d = derivative T_u; or the settings from `from_loop`."""

    name: str
    form: str
    """`P`, `PI` or `PID`."""
    source: str
    """Paper and equation."""
    gain: float = nan
    integral: float | None = None
    derivative: float | None = None
    from_loop: Callable[[Loop], Controller] | None = None
    """Function from a loop to settings; raises ValueError for a loop to which the rule does not apply."""

    @property
    def title(self) -> str:
        """Name and form, for instance `Ziegler-Nichols PI`."""
        return f"{self.name} {self.form}"

    def settings(self, K_u: float, T_u: float, loop: Loop | None = None) -> Controller:
        """The controller in ideal form, from the ultimate gain `K_u` [any unit] and period `T_u` [s], or from the loop.

        Raises ValueError where the rule needs a loop and there is none, or it does not apply to it.
        """
        if self.from_loop is None:
            T_i = inf if self.integral is None else self.integral * T_u
            return Controller(self.gain * K_u, T_i, 0.0 if self.derivative is None else self.derivative * T_u)
        if loop is None:
            raise ValueError(f"{self.name} needs the dead time and the lags of the loop")
        return self.from_loop(loop)


def simc(loop: Loop, form: str) -> Controller:
    """The `PI` or `PID` controller for `loop`, in ideal form, by the SIMC rules (`SIMC_SOURCE`).

    The half rule reduces all lags to one (PI) or two (PID) and a dead time. The closed-loop time constant is chosen
    equal to that dead time, which the paper recommends for tight control with good robustness.

    With lags T1 >= T2 >= T3 ...: PI has tau_1 = T1 + T2/2, theta = L + T2/2 + T3 + ...; PID has tau_1 = T1,
    tau_2 = T2 + T3/2, theta = L + T3/2 + T4 + .... K_c = tau_1/(2 k_g theta), tau_I = min(tau_1, 8 theta),
    tau_D = tau_2 in series form; the ideal form has K_p = f K_c, T_i = f tau_I, T_d = tau_D/f, f = 1 + tau_D/tau_I.

    Raises ValueError for complex lags, too few lags, or no dead time (or further lag).

    >>> found = simc(Loop(1.0, 1.0, (10.0, 2.0)), "PI")
    >>> round(found.K_p, 3), found.T_i
    (2.75, 11.0)
    """
    if any(complex(lag).imag for lag in loop.lags):
        raise ValueError("SIMC's half rule is for lags that do not swing")
    lags = sorted((complex(lag).real for lag in loop.lags if lag), reverse=True)
    kept = 1 if form == "PI" else 2
    if len(lags) < kept:
        raise ValueError(f"SIMC needs {kept} lags for a {form} controller, the loop has {len(lags)}")
    half = lags[kept] / 2 if len(lags) > kept else 0.0
    theta = loop.dead_time + half + sum(lags[kept + 1 :])
    if theta <= 0:
        raise ValueError("SIMC needs a dead time, or a lag that counts as one: without, any gain is stable")
    lags[kept - 1] += half
    slow = min(lags[0], 8 * theta)
    K_c = lags[0] / (2 * loop.gain * theta)
    if form == "PI":
        return Controller(K_c, slow)
    factor = 1 + lags[1] / slow
    return Controller(K_c * factor, slow * factor, lags[1] / factor)


ZN, TL = "Ziegler-Nichols", "Tyreus-Luyben"
ZN_SOURCE = "Ziegler and Nichols, Trans. ASME 64 (1942) 759, ultimate-gain (second, closed-loop) method"
TL_SOURCE = "Tyreus and Luyben, Ind. Eng. Chem. Res. 31 (1992) 2625"
SIMC_SOURCE = "Skogestad, J. Process Control 13 (2003) 291, SIMC with tau_c = theta"
RULES = (
    Rule(ZN, "P", ZN_SOURCE, 0.5),
    Rule(ZN, "PI", ZN_SOURCE, 0.45, 1 / 1.2),
    Rule(ZN, "PID", ZN_SOURCE, 0.6, 1 / 2, 1 / 8),
    Rule(TL, "PI", TL_SOURCE, 1 / 3.2, 2.2),
    Rule(TL, "PID", TL_SOURCE, 1 / 2.2, 2.2, 1 / 6.3),
    *(Rule("SIMC", form, SIMC_SOURCE, from_loop=partial(simc, form=form)) for form in ("PI", "PID")),
)
GROUP = "pmabench.rules"


@lru_cache(maxsize=1)
def all_rules() -> tuple[Rule, ...]:
    """Every rule; those that need the loop itself come last."""
    found = list(RULES)
    for point in entry_points(group=GROUP):
        brought = point.load()
        found += [brought] if isinstance(brought, Rule) else brought
    return tuple(sorted(found, key=lambda rule: rule.from_loop is not None))


def find(name: str, form: str) -> Rule | None:
    """The rule of a name for a form of controller (`P`, `PI`, `PID`); None where it has none for that."""
    return next((rule for rule in all_rules() if (rule.name, rule.form) == (name, form)), None)
