"""Settings from a known loop by the SIMC rules (Skogestad, J. Process Control 13, 2003, 291); no data.

The half rule makes one lag (PI) or two (PID) of all, the rest becomes dead time. The closed loop is to have a lag as
long as that dead time, the choice of the paper for tight control with good robustness.
"""

from __future__ import annotations

from functools import partial

from pmabench.model.loop import Controller, Loop
from pmabench.model.rules.record import Rule

SOURCE = "Skogestad, J. Process Control 13 (2003) 291, SIMC with tau_c = theta"


def simc(loop: Loop, form: str) -> Controller:
    """The `PI` or `PID` controller for `loop`, in ideal form.

    With lags T1 >= T2 >= T3 ...: PI has tau_1 = T1 + T2/2, theta = L + T2/2 + T3 + ...; PID has tau_1 = T1,
    tau_2 = T2 + T3/2, theta = L + T3/2 + T4 + .... K_c = tau_1/(2 k_g theta), tau_I = min(tau_1, 8 theta),
    tau_D = tau_2 in series form; the ideal form has K_p = f K_c, T_i = f tau_I, T_d = tau_D/f, f = 1 + tau_D/tau_I.

    Raises ValueError for a loop without what the rule needs: a dead time or a lag more, lags that do not swing.

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


RULES = tuple(Rule("SIMC", form, SOURCE, from_loop=partial(simc, form=form)) for form in ("PI", "PID"))
