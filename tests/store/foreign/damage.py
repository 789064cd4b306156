"""Files whose numbers are partly wrong: sentinels, bursts, frozen, late and exchanged channels (finding 7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.store.foreign.case import NAME, Array, Case, Measured, clean, plain

OUTLIERS = r"sentinel|spike|outlier|burst|implausib|placeholder|out of.*range|overrange|repeat|9999|suspect"
Harm = Callable[[Measured, np.random.Generator], tuple[Array, Array, Array]]


def _five(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    F = test.F.copy()
    F[[400, 401, 1200, 1901, 2500]] = 9999
    return test.t, test.P, F


def _every_50th(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    F = test.F.copy()
    F[::50] = 9999 * (-1.0) ** np.arange(len(F[::50]))
    return test.t, test.P, F


def _well_log(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    P = test.P.copy()
    P[chance.choice(len(P), 20, replace=False)] = -999.25
    return test.t, P, test.F


def _huge(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    F = test.F.copy()
    F[[700, 1500, 1501]] = 1e10
    return test.t, test.P, F


def _frozen_force(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    F = test.F.copy()
    F[600:800] = F[600]
    return test.t, test.P, F


def _frozen_pressure(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    P = test.P.copy()
    P[2000:] = P[2000]
    return test.t, P, test.F


def _late(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    return test.t, test.P, np.concatenate((np.full(100, test.F[0]), test.F[:-100]))


def _gain(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    return test.t, test.P, np.where(np.arange(len(test.F)) < 1500, test.F, 1.3 * test.F)


def _offset(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    return test.t, test.P, np.where(np.arange(len(test.F)) < 1500, test.F, test.F + 80)


def _exchanged(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    early = np.arange(len(test.t)) < 1500
    return test.t, np.where(early, test.P, test.F), np.where(early, test.F, test.P)


def _clipped(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    return test.t, test.P, np.minimum(test.F, 800.0)


def _burst(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    F = test.F.copy()
    F[900:940] += chance.uniform(-3000, 3000, 40)
    return test.t, test.P, F


def _dropouts(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    F = test.F.copy()
    F[chance.choice(np.arange(800, 2200), 30, replace=False)] = 0.0
    return test.t, test.P, F


def _point_lost(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    F = test.F.copy()
    F[chance.choice(np.arange(300, 2700), 25, replace=False)] *= 100
    return test.t, test.P, F


def _wires(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    return test.t, test.P, np.where(np.arange(len(test.F)) < 1600, test.F, -test.F)


def _buffer_twice(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    order = np.concatenate((np.arange(1200), np.arange(1000, 1200), np.arange(1200, len(test.t))))
    return test.t[order], test.P[order], test.F[order]


def _clock_back(test: Measured, chance: np.random.Generator) -> tuple[Array, Array, Array]:
    return np.where(np.arange(len(test.t)) < 1500, test.t, test.t - 5.0), test.P, test.F


HARMS: dict[str, tuple[Harm, str]] = {
    "five rows of 9999": (_five, OUTLIERS),
    "every 50th row 9999 or -9999": (_every_50th, OUTLIERS),
    "-999.25 in the pressure": (_well_log, OUTLIERS + "|999"),
    "1e10 in three rows": (_huge, OUTLIERS + "|1e\\+?10"),
    "force frozen for 2 s": (_frozen_force, r"fr[eo]ze|stale|stuck|(does|did) not change|unchanged|constant"),
    "pressure frozen from 20 s on": (_frozen_pressure, r"fr[eo]ze|stale|stuck|(does|did) not change|unchanged"),
    "force 1 s late": (_late, r"\blate|\blag|behind|delay|later than"),
    "gain of force changes in mid-file": (_gain, r"gain|scale|slope|changes? (in|at)|breaks?\b|jump|leap"),
    "force jumps by 80 N in mid-file": (_offset, r"jump|leap|offset|shift|changes? (in|at)|breaks?\b"),
    "columns exchanged from row 1500 on": (_exchanged, r"exchang|swap|jump|changes? places|scale"),
    "force clipped at 800 N": (_clipped, r"clip|saturat|end of (its|the) range|overrange|flat|stuck|stale|same value"),
    "burst of 40 rows": (_burst, OUTLIERS + r"|noise|scatter|leap|jump"),
    "thirty single zeros": (_dropouts, OUTLIERS + r"|dropout|zero|drop-out"),
    "decimal point lost in 25 rows": (_point_lost, OUTLIERS + r"|decimal"),
    "sign of force turns in mid-file": (_wires, r"sign|jump|scale|slope|polarity|negative|pushes"),
    "a buffer written twice": (_buffer_twice, r"time.?jump|back|twice|duplicat|repeat|same"),
    "clock set back by 5 s": (_clock_back, r"time.?jump|back|clock|decreas|not rising"),
}


def cases() -> list[Case]:
    """A harm each, in the plainest layout."""
    found = []
    for number, (name, (harm, words)) in enumerate(HARMS.items()):
        test = clean(10 + number)
        columns = harm(test, np.random.default_rng(number))
        case = Case(name, "damage", {NAME: plain(*columns)}, words, (test,), damaged=True)
        found.append(replace(case, clock=1e9) if name == "clock set back by 5 s" else case)
    return found
