"""Each pair of kinds of test that share a quantity: alike they agree, and one that is wrong is refused.

The analyses are written down from one straight muscle at 300 kPa, F = 275 N - 6.773 N/mm x, with 6 N of friction.
"""

from dataclasses import replace

import numpy as np
import pytest

from pmabench.kinds.reduce import compared
from pmabench.store.analyses.results import Analysis, Estimate, Parts, Trace

P, F_CE, K, B, RUBS = 3e5, 275.0, 6773.0, 1900.0, 6.0
START = 10e-3
HALF = 0.004
"""Half width of every interval, as a share of the value."""


def known(symbol, value, quantity, method, at=None, coordinate="", half=None, wrong=1.0):
    unit = {"force": "N", "stiffness": "N/m", "damping": "N.s/m", "length": "m", "pressure": "Pa"}
    half = HALF * abs(value) if half is None else half
    at = {"pressure": P} if at is None else at
    return Estimate(
        symbol, value * wrong, unit.get(quantity, "N/Pa"), quantity, method, at, Parts(half), 20, coordinate=coordinate
    )


def force(x):
    return F_CE - K * x


def steps(wrong=1.0):
    """K of rests K + 2 f / s, forces at rest above the mean after stretching and below after contracting."""
    found = []
    for s in (5e-3, 10e-3):
        at = {"pressure": P, "start": START, "step": s, "speed": 0.4}
        found += [
            known("K", K + 2 * RUBS / s, "stiffness", "step, relaxed", at, wrong=wrong),
            known("F", force(START) + RUBS, "force", "step, relaxed", at, "before", wrong=wrong),
            known("F", force(START + s) - RUBS, "force", "step, relaxed", at, "relaxed", wrong=wrong),
        ]
    return Analysis("step-displacement", ("steps",), False, tuple(found))


def contraction(wrong=1.0):
    fact = [{"phase": "contract", "pressure": P, "load": 0.0, "x_inf": 39.7e-3}]
    found = [known("F_ce", F_CE, "force", "measured-pressure"), known("K", K, "stiffness", "measured-pressure")]
    found += [known(symbol, B, "damping", "measured-pressure") for symbol in ("B_c", "B_r")]
    return Analysis("contraction-relaxation", ("moved",), False, _scaled(found, wrong), facts={"steps": fact})


def _scaled(found, wrong):
    return tuple(replace(e, value=e.value * wrong) for e in found)


def isobaric(wrong=1.0):
    places = [i * 5e-3 for i in range(5)]
    found = [known("K", K, "stiffness", "mean-curve"), known("B", B, "damping", "loop-gap")]
    found += [
        known("F", force(x), "force", "mean-curve, local", {"pressure": P, "contraction": x}, half=1.0) for x in places
    ]
    x = np.linspace(0.0, 20e-3, 81)
    columns = {"displacement": x, "force": wrong * force(x)}
    trace = Trace("mean-curve-300", "mean-curve", "", columns, {}, {"pressure": P})
    return Analysis("isobaric-ramp", ("ramps",), False, _scaled(found, wrong), traces=(trace,))


def sines(wrong=1.0):
    found = [known("B", B, "damping", "sine-harmonic")]
    for x in (12.5e-3, 17.5e-3):
        at = {"pressure": P, "mean": x}
        found += [known("K", K, "stiffness", "sine-harmonic", at), known("F", force(x), "force", "sine-mean", at)]
    return Analysis("sinusoidal-displacement", ("sines",), False, _scaled(found, wrong))


def static(wrong=1.0):
    found = [known("F_ce", F_CE + d, "force", "static-mean", {"pressure": P + 500 * d}) for d in (-100.0, 0.0, 100.0)]
    return Analysis("static-load", ("weights",), False, _scaled(found, wrong))


def isometric(wrong=1.0):
    """F_ce, K, and where the force begins: dF_ce/dP is 2 N/kPa, K does not depend on the pressure."""
    found = [known("F_ce", F_CE, "force", "isometric-sections"), known("K", K, "stiffness", "isometric-sections")]
    for x in (0.0, 20e-3, 40e-3):
        begins = P + (K * x - F_CE) / 2e-3
        found.append(known("p_0", begins, "pressure", "force-threshold", {"contraction": x}, half=0.2e3))
    return Analysis("isometric-pressurisation", ("held",), False, _scaled(found, wrong))


def free(wrong=1.0):
    pressures = [1.6e5 + 1e4 * i for i in range(16)]
    found = []
    for at in pressures:
        x = max(0.0, F_CE + 2e-3 * (at - P)) / K
        found.append(known("L", 0.25 - wrong * x, "length", "free-length", {"pressure": at}, half=0.1e-3))
    found += [known("x_H", 0.0, "length", "free-length", {"pressure": at}, half=0.1e-3) for at in pressures]
    facts = {"measured": pressures, "nominal_length": 0.25}
    return Analysis("free-contraction", ("free",), False, tuple(found), facts=facts)


def recorded(wrong=1.0, kind="isometric"):
    """Forces over pressure at 0, 10 and 12.5 mm."""
    found, cells = [], []
    for x in (0.0, START, 12.5e-3, 15e-3):
        found.append(known("m", 2e-3, "force per pressure", "isometric-line", {"contraction": x}, "slope"))
        rows = [[at, wrong * (force(x) + 2e-3 * (at - P)), HALF * F_CE, 0.0, 0.0] for at in (2.5e5, P, 4e5)]
        cells.append({"contraction": x, "forces": rows})
    return Analysis(kind, (kind,), False, tuple(found), facts={"cells": cells})


def recorded_step(wrong=1.0):
    at = {"from": 1e5, "pressure": P}
    kinds = (("K", K, "stiffness"), ("B", B, "damping"))
    found = [known(symbol, value, quantity, "ringing-of-known-mass", at) for symbol, value, quantity in kinds]
    return Analysis("recorded-step", ("rings",), False, _scaled(found, wrong))


def recorded_pull(wrong=1.0):
    return recorded(wrong, "recorded-pull")


PAIRS = [
    *((steps, other) for other in (contraction, isobaric, isometric, sines, recorded, recorded_pull, recorded_step)),
    *((other, free) for other in (contraction, isometric)),
    *((recorded, other) for other in (contraction, isobaric, isometric, sines, static, recorded_pull)),
    *((recorded_pull, other) for other in (contraction, isobaric, isometric, sines, static)),
    *((recorded_step, other) for other in (contraction, isobaric, isometric, sines)),
]
"""Every pair of which one is no kind that was compared before."""


def named(pair):
    return "-".join(one.__name__ for one in pair)


@pytest.mark.parametrize("pair", PAIRS, ids=named)
def test_tests_of_one_muscle_agree(pair):
    found = compared([make() for make in pair])
    assert found.refusals == ()
    assert {f.level for f in found.findings} == {"note"}
    assert found.facts["comparisons"] >= 1


@pytest.mark.parametrize("wrong", [0.9, 1.1])
@pytest.mark.parametrize("pair", PAIRS, ids=named)
def test_a_test_that_is_a_tenth_off_is_refused_for_both(pair, wrong):
    """Force cell, or displacement, by a tenth: K and F of one test with it."""
    one, two = pair
    found = compared([one(), two(wrong)])
    assert found.refusals
    assert any(finding.level == "doubt" for finding in found.findings)
    assert all(found.runs[0] != found.runs[1] and "disagree" in refusal for refusal in found.refusals)


@pytest.mark.parametrize("pair", PAIRS, ids=named)
def test_three_half_widths_are_no_chance(pair):
    """Three times the narrowest combined interval, of one way: friction may explain the other way.

    Where friction alone keeps both apart (a force at rest against one of a recorded line) it is beyond that.
    """
    one, two = pair
    size = {"K": K, "B": B, "F": force(START), "F_ce": F_CE, "x": F_CE / K}
    shares = [e.parts.combined / size[e.symbol] for e in compared([one(), two()]).estimates]
    three = 3 * min(shares) if shares else (3 * 2**0.5 * HALF * F_CE + RUBS) / force(START)
    assert any(compared([one(), two(1 + way * three)]).refusals for way in (1, -1))


def test_friction_between_rests_is_distinguished_from_stiffness():
    """K + 2 f / s is 9.17 N/mm at 5 mm: more than K, and no contradiction."""
    found = compared([contraction(), steps()])
    (text,) = [
        f.text for f in found.findings if f.text.startswith("K, contraction against step of displacement, at rest")
    ]
    assert "friction between the two rests is in it" in text
    (of_two,) = [e for e in found.estimates if e.method.endswith("steps of two sizes")]
    assert of_two.value == pytest.approx(0.0, abs=1e-6)
    assert of_two.at == {"pressure": P, "contraction": pytest.approx(17.5e-3)}


def test_nothing_is_compared_beyond_what_was_lifted():
    """A force at 30 mm against contraction whose loads took it to 20 mm: no comparison, and none in silence at 0."""
    short = replace(
        contraction(), facts={"steps": [{"phase": "contract", "pressure": P, "load": 100.0, "x_inf": 20e-3}]}
    )
    far = {"pressure": P, "mean": 30e-3}
    deep = Analysis("sinusoidal-displacement", ("s",), False, (known("F", 0.5 * F_CE, "force", "sine-mean", far),))
    assert compared([short, deep]) is None
    assert compared([contraction(), deep]).refusals
    assert compared([short, free()]) is None


def test_a_contraction_from_below_alone_may_only_be_short():
    """Friction keeps it from its rest: 1 mm short is no contradiction, 1 mm too far is one."""
    for change, refused in ((-1e-3, False), (1e-3, True)):
        below = free()
        lengths = tuple(replace(e, value=e.value - change) for e in below.estimates if e.symbol == "L")
        assert bool(compared([isometric(), replace(below, estimates=lengths)]).refusals) == refused
