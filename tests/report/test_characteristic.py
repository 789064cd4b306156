"""Tests on common axes: blocked force beside free contraction, force over contraction beside the model."""

import numpy as np
import pandas as pd
import pytest

from pmabench.report.figures.characteristic_figures import characteristic
from pmabench.store.analyses.results import Analysis, Estimate, Parts, Trace

PRESSURES = (1e5, 2e5, 3e5, 4e5)
K = 7000.0


def F_ce(P):
    return 1.08e-3 * P - 49.0


def reported(symbol, value, P, method, unit, quantity):
    return Estimate(symbol, value, unit, quantity, method, {"pressure": P}, Parts(repeats=1e-3 * value), n=3)


def steps():
    found = [reported("F_ce", F_ce(P), P, "measured-pressure", "N", "force") for P in PRESSURES]
    found += [reported("K", K, P, "measured-pressure", "N/m", "stiffness") for P in PRESSURES]
    return Analysis("contraction-relaxation", ("r1",), True, estimates=tuple(found))


def isometric(off=0.0):
    rows = np.array([(P, x, max(F_ce(P) - K * x + off, 0.0)) for P in PRESSURES for x in (0.0, 0.005, 0.01, 0.03)]).T
    columns = dict(zip(("pressure", "displacement", "force"), rows, strict=True))
    quantities = {"pressure": "pressure", "displacement": "length", "force": "force"}
    trace = Trace("characteristic", "characteristic", "held", columns, quantities)
    found = tuple(reported("F_b", F_ce(P) + off, P, "blocked", "N", "force") for P in PRESSURES)
    facts = {"specimen": {"nominal_length": 0.25}}
    return Analysis("isometric-pressurisation", ("r2",), True, estimates=found, traces=(trace,), facts=facts)


def free():
    found = tuple(reported("L", 0.25 - F_ce(P) / K, P, "free-length", "m", "length") for P in PRESSURES)
    return Analysis("free-contraction", ("r3",), False, estimates=found, facts={"nominal_length": 0.25})


def test_blocked_force_is_next_to_free_contraction():
    ends, _ = characteristic([steps(), isometric(), free()])
    row = pd.DataFrame(ends.table.rows).set_index("P [kPa]").loc["300"]
    assert row["blocked force F_b [N]"].startswith("275.0")
    assert row["free contraction [mm]"].startswith("39.29")  # 275 N by 7 N/mm
    assert float(row["free contraction [%]"]) == pytest.approx(15.71, abs=0.005)
    assert "up to 383 N at 400 kPa" in ends.alt
    assert "54.71 mm (21.9 % of the nominal length) at 400 kPa" in ends.alt
    assert ends.simulated


def test_the_difference_of_measured_force_and_model_is_reported():
    _, family = characteristic([steps(), isometric(off=2.0), free()])
    table = pd.DataFrame(family.table.rows).set_index(["P [kPa]", "x [mm]"])
    assert table.loc[("400", "30.00"), "F measured [N]"] == "175.0"
    assert table.loc[("400", "30.00"), "F model [N]"] == "173.0"
    assert set(table["difference [N]"]) == {"2.00"}
    assert "2 N rms" in family.caption
    assert "steps at constant load" in family.caption
    assert ("200", "30.00") not in table.index, "a slack muscle is no measured force"


def test_each_part_comes_alone_where_the_other_tests_lack():
    assert [p.title for p in characteristic([isometric()])] == ["Force, pressure and contraction"]
    assert characteristic([steps(), free()]) == []
    (family,) = characteristic([isometric()])
    assert "model" not in family.caption
    assert "F model [N]" not in family.table.columns
