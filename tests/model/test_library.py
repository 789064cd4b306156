"""The library of models against printed tables, closed forms and independent computations (docs/papers.md)."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from pmabench.base.quantities import QUANTITIES
from pmabench.model.library import MODELS, OutsideDomain

BAR, CM = 1e5, 1e-2


def printed(text):
    """Rows of a table as (value, half a unit of its last digit)."""
    return [
        [(float(cell), 0.5 * 10.0 ** -len(cell.partition(".")[2])) for cell in line.split()]
        for line in text.strip().splitlines()
    ]


def agree(value, cell, scale=1.0):
    expected, rounding = cell
    assert value / scale == pytest.approx(expected, abs=1.0001 * rounding)


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_every_model_gives_its_reference_values(model):
    for reference in model.references:
        value = float(model.evaluate(reference.at)[reference.output])
        assert value == pytest.approx(reference.value, rel=1e-12, abs=1.0001 * reference.rounding), reference


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_every_model_says_what_it_takes_and_gives(model):
    assert model.references, "a model needs a value that it can be checked against"
    assert model.source
    assert model.equation
    for item in (*model.parameters, *model.outputs):
        assert item.quantity in QUANTITIES or (item.quantity == "" and item.choices), item
    found = model.evaluate()
    assert set(found) == {output.name for output in model.outputs}
    assert all(np.isfinite(values).all() for values in found.values())
    for reference in model.references:
        assert reference.output in found
        assert set(reference.at) <= {p.name for p in model.parameters}


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_every_input_is_refused_outside_its_domain_and_named(model):
    ends = [(p, getattr(p, end), way) for p in model.parameters for end, way in (("low", -1), ("high", 1))]
    for p, end, way in ends:
        if p.choices or not math.isfinite(end):
            continue
        beyond = end + way * 1e-6 * (1 + abs(end))
        with pytest.raises(OutsideDomain) as caught:
            model.evaluate({p.name: [p.value, beyond]})
        assert [(refusal.name, refusal.value) for refusal in caught.value.refusals] == [(p.name, beyond)]


@pytest.mark.parametrize("name", MODELS)
def test_arrays_give_what_single_values_give(name):
    model = MODELS[name]
    first = next(p for p in model.parameters if not p.choices and p.quantity != "count")
    values = [first.value, first.value * (1 - 1e-3)]
    together = model.evaluate({first.name: values})
    small = {output.name: 1e-2 if output.quantity == "pressure" else 0.0 for output in model.outputs}  # [Pa]
    for row, value in enumerate(values):
        alone = model.evaluate({first.name: value})
        for output in alone:
            column = np.broadcast_to(together[output], (2,))
            assert float(column[row]) == pytest.approx(float(alone[output]), rel=1e-6, abs=small[output])


def test_all_that_is_wrong_is_reported_at_once():
    with pytest.raises(OutsideDomain) as caught:
        MODELS["tondu-lopez"].evaluate({"pressure": -1.0, "radius": 0.0, "k": math.nan})
    assert [refusal.name for refusal in caught.value.refusals] == ["pressure", "radius", "k"]
    assert "finite" in str(caught.value)


def test_an_input_that_is_unknown_is_no_silent_default():
    with pytest.raises(KeyError, match="presure"):
        MODELS["tondu-lopez"].evaluate({"presure": 1e5})


# -- force of the braid ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [15, 25, 40, 54, 60, 75])
def test_chou_hannaford_does_the_work_of_its_volume(angle):
    b, n, P = 0.25, 1.2, 3e5

    def at(theta):
        return MODELS["chou-hannaford"].evaluate({"pressure": P, "strand_length": b, "turns": n, "braid_angle": theta})

    theta, h = math.radians(angle), 1e-6
    low, high = at(theta - h), at(theta + h)
    work = -P * (high["volume"] - low["volume"]) / (high["length"] - low["length"])
    assert float(at(theta)["force"]) == pytest.approx(float(work), rel=1e-7)
    found = at(theta)
    assert math.hypot(float(found["length"]), float(found["diameter"]) * n * math.pi) == pytest.approx(b)


def test_an_extensor_pushes():
    model = MODELS["chou-hannaford"]
    assert float(model.evaluate({"braid_angle": math.radians(54.74)})["force"]) < 0
    assert float(model.evaluate({"braid_angle": math.radians(54.73)})["force"]) > 0


def test_tondu_lopez_is_chou_hannaford_for_k_1():
    b, n, theta0, P = 0.25, 1.2, math.radians(25), 4e5
    for eps in (0.0, 0.1, 0.2, 0.3):
        theta = math.acos((1 - eps) * math.cos(theta0))
        old = MODELS["chou-hannaford"].evaluate({"pressure": P, "strand_length": b, "turns": n, "braid_angle": theta})
        radius = b * math.sin(theta0) / (2 * math.pi * n)
        new = MODELS["tondu-lopez"].evaluate(
            {"pressure": P, "contraction": eps, "radius": radius, "braid_angle": theta0}
        )
        assert float(new["force"]) == pytest.approx(float(old["force"]), rel=1e-12)


@pytest.mark.parametrize("k", [0.8, 1.0, 1.35, 3.0])
def test_k_leaves_the_force_at_rest_length_and_moves_the_end(k):
    model = MODELS["tondu-lopez"]
    assert float(model.evaluate({"k": k})["force"]) == pytest.approx(float(model.evaluate()["force"]), rel=1e-14)
    end = float(model.evaluate({"k": k})["contraction_max"])
    assert end == pytest.approx((1 - 1 / (math.sqrt(3) * math.cos(math.radians(25)))) / k, rel=1e-12)
    around = model.evaluate({"k": k, "contraction": [end - 1e-6, end + 1e-6, 1.0]})["force"]
    assert around[0] > 0
    assert around[1:].tolist() == [0.0, 0.0]


def test_k_of_p_is_the_constant_model_with_that_k_and_ends_with_what_was_measured():
    model = MODELS["tondu-lopez-k-of-p"]
    found = model.evaluate({"pressure": [1e5, 3.5e5, 6e5], "contraction": 0.1})
    assert found["k"].tolist() == pytest.approx([1.4, 1.25, 1.1])
    for P, k, force in zip([1e5, 3.5e5, 6e5], found["k"], found["force"], strict=True):
        same = MODELS["tondu-lopez"].evaluate({"pressure": P, "contraction": 0.1, "k": k})["force"]
        assert float(force) == pytest.approx(float(same), rel=1e-12)
    for P in (0.99e5, 6.01e5):
        with pytest.raises(OutsideDomain, match="k is known"):
            model.evaluate({"pressure": P})


def test_strands_without_stretch_are_tondu_lopez_and_stretch_costs_force():
    P, eps, theta0, S0, n = 5e5, 0.12, math.radians(25), 0.25, 1.2
    given = {"pressure": P, "contraction": eps, "strand_length": S0, "turns": n, "braid_angle": theta0}
    plain = MODELS["strand-stretch"].evaluate(given)
    radius = float(plain["diameter"]) / 2
    same = MODELS["tondu-lopez"].evaluate({"pressure": P, "contraction": eps, "radius": radius, "braid_angle": theta0})
    assert float(plain["force"]) == pytest.approx(float(same["force"]), rel=1e-12)
    # a longer strand put into Chou-Hannaford at the same length is the same as k_s
    k_s = 1.05
    length = (1 - eps) * S0 * math.cos(theta0)
    theta = math.acos(length / (k_s * S0))
    exact = MODELS["chou-hannaford"].evaluate(
        {"pressure": P, "strand_length": k_s * S0, "turns": n, "braid_angle": theta}
    )
    stretched = MODELS["strand-stretch"].evaluate({**given, "k_s": k_s})
    assert float(stretched["force"]) == pytest.approx(float(exact["force"]), rel=1e-12)
    assert float(stretched["force"]) < float(plain["force"])
    with pytest.raises(OutsideDomain, match="no force even"):
        MODELS["strand-stretch"].evaluate({"k_s": 1.6})


# -- paper 2: length, force, arm -------------------------------------------------------------------------------------

SIGMOID = """
15 0.2835 5.407 0.1887 26.8 32.2 34.1 35.9 0.54 36.7 37.8 0.23
20 0.4780 6.094 0.1757 18.4 26.3 29.0 31.3 0.85 32.8 33.9 0.38
25 0.6475 6.311 0.1663 11.9 21.7 25.1 28.0 1.13 30.4 31.5 0.50
30 0.7470 6.111 0.1589 8.5 18.9 22.7 26.1 1.30 29.5 30.6 0.56
40 0.5560 4.668 0.1480 11.5 19.6 23.1 26.4 1.13 32.2 33.3 0.36
"""


@pytest.mark.parametrize("row", printed(SIGMOID), ids=lambda row: f"{row[0][0]:g} cm")
def test_table_of_the_sigmoid_length(row):
    model = MODELS["sigmoid-length"]
    L0 = row[0][0] * CM

    def contraction(p_bar, exponent="mended"):
        given = {"pressure": p_bar * BAR, "nominal_length": L0, "exponent": exponent}
        return float(model.evaluate(given)["contraction"])

    def half(exponent):
        return brentq(lambda p: contraction(p, exponent) - contraction(5, exponent) / 2, 0.01, 5)

    found = model.evaluate({"nominal_length": L0})
    agree(float(found["c"]), row[1], BAR)
    agree(float(found["d"]), row[2])
    agree(float(found["e"]), row[3])
    for cell, p in zip(row[4:8], (1, 2, 3, 5), strict=True):
        agree(contraction(p), cell, 0.01)
    agree(half("mended"), row[8])
    for cell, p in zip(row[9:11], (1, 5), strict=True):
        agree(contraction(p, "printed"), cell, 0.01)
    agree(half("printed"), row[11])
    assert contraction(0) == pytest.approx(0, abs=1e-15)
    p = np.linspace(0, 5 * BAR, 501)
    for exponent in ("mended", "printed"):
        lengths = model.evaluate({"pressure": p, "nominal_length": L0, "exponent": exponent})["length"]
        assert (np.diff(lengths) < 0).all()


def test_the_printed_exponent_is_nearly_a_step_which_is_why_it_is_not_the_default():
    for L0, percent in zip((15, 20, 25, 30, 40), (97, 96, 83, 65, 95), strict=True):
        given = {"pressure": [0.6e5, 5e5], "nominal_length": L0 * CM, "exponent": "printed"}
        part = MODELS["sigmoid-length"].evaluate(given)["contraction"]
        assert 100 * part[0] / part[1] == pytest.approx(percent, abs=0.6)


@pytest.mark.parametrize("L0", [0.12, 0.50])
def test_the_sigmoid_is_refused_for_lengths_that_nobody_measured(L0):
    with pytest.raises(OutsideDomain, match="15 to 40 cm were measured"):
        MODELS["sigmoid-length"].evaluate({"nominal_length": L0})


def test_the_corrected_force_begins_at_its_threshold_without_a_jump():
    model = MODELS["corrected-force"]
    forces = model.evaluate({"pressure": [0.0, 0.3e5, 0.45e5, 0.45001e5, 1e5]})["force"]
    assert forces[:3].tolist() == [0, 0, 0]
    assert 0 < forces[3] < 0.01
    a, b = 3 / math.tan(math.radians(25)) ** 2, 1 / math.sin(math.radians(25)) ** 2
    assert forces[4] == pytest.approx(math.pi * 1e-4 * 0.55e5 * (a - b))
    q = 1 + math.exp(-3)
    at = model.evaluate({"pressure": 3e5, "contraction": 0.1, "threshold": 0.6e5})["force"]
    assert float(at) == pytest.approx(math.pi * 1e-4 * 2.4e5 * (a * (1 - 0.1 * q) ** 2 - b))


ARM = """
0    3.8 84.333 -0.21
0.1  3.4 84.0   -0.74
0.2  3.8 75.5   -0.06
0.3  3.4 66.0   -0.48
0.4  3.0 57.0   -0.39
0.5  2.8 47.0   -0.13
"""


@pytest.mark.parametrize("row", printed(ARM), ids=lambda row: f"{row[0][0]:g} kg")
def test_the_arm_against_table_1_of_paper_2(row):
    (load, _), (p, _), (angle, _), deviation = row
    found = MODELS["arm-angle"].evaluate({"load": load, "pressure": p * BAR})["angle"]
    agree(math.degrees(float(found)) - angle, deviation)
    at_rest = float(MODELS["arm-angle"].evaluate({"load": load, "pressure": 0.45 * BAR})["angle"])
    assert 2.05 < math.degrees(at_rest) < 4.75
    highest = math.degrees(float(MODELS["arm-angle"].evaluate({"load": load, "pressure": 5 * BAR})["angle"]))
    assert 0.345 < highest - angle < 0.565 or load == 0.1


# -- papers 0 and 1: coefficients ------------------------------------------------------------------------------------

DMSP = """
1.0 26.65 17.35 10.09  0.651 0.379
1.5 27.39 16.12 15.79  0.589 0.577
2.0 30.99 16.29 20.93  0.526 0.675
2.5 35.51 16.80 28.33  0.473 0.798
3.0 40.22 17.35 38.05  0.431 0.946
3.5 45.00 18.00 49.00  0.400 1.089
4.0 49.89 18.90 60.08  0.379 1.204
4.5 54.88 20.10 70.87  0.366 1.291
5.0 59.85 21.53 81.84  0.360 1.367
5.5 64.68 23.06 94.10  0.357 1.455
6.0 69.59 24.71 108.70 0.355 1.562
"""


@pytest.mark.parametrize("row", printed(DMSP), ids=lambda row: f"{row[0][0]:g} bar")
def test_table_of_the_polynomials_of_paper_1(row):
    found = MODELS["dmsp-40-305"].evaluate({"pressure": row[0][0] * BAR})
    for name, cell in zip(("stiffness", "damping_contract", "damping_relax"), row[1:4], strict=True):
        agree(float(found[name]), cell, 1e3)
    agree(float(found["tau_contract"]), row[4])
    agree(float(found["tau_relax"]), row[5])


def test_the_lines_of_paper_1_are_fits_through_its_eleven_pressures():
    P = np.linspace(1e5, 6e5, 11)
    assert P.std(ddof=1) == pytest.approx(1.6583e5, abs=5)
    curve, line = (MODELS["dmsp-40-305"].evaluate({"pressure": P, "fit": fit}) for fit in ("polynomial", "line"))
    for name in ("stiffness", "damping_contract", "damping_relax"):
        fitted = np.polyval(np.polyfit(P, curve[name], 1), P)
        np.testing.assert_allclose(line[name], fitted, atol=4)


@pytest.mark.parametrize("pressure", [0.0, 0.5e5, 0.99e5, 6.1e5])
@pytest.mark.parametrize("name", ["dmsp-40-305", "dmsp-40-305-contraction"])
def test_the_polynomials_are_never_extrapolated(name, pressure):
    with pytest.raises(OutsideDomain, match="negative"):
        MODELS[name].evaluate({"pressure": pressure})


def test_no_damping_is_ever_negative():
    P = np.linspace(1e5, 6e5, 1001)
    for fit in ("polynomial", "line"):
        found = MODELS["dmsp-40-305"].evaluate({"pressure": P, "fit": fit})
        assert min(found["damping_contract"].min(), found["damping_relax"].min()) > 0


@pytest.mark.parametrize(
    ("fce_at", "contractions"),
    [("x0", "33.0 57.0 65.9 70.9 73.9 76.3"), ("xmax", "24.3 35.5 38.9 40.6 41.6 42.4")],
)
def test_both_conventions_of_f_ce_give_their_printed_contractions(fce_at, contractions):
    P = np.arange(1, 7) * BAR
    found = MODELS["dmsp-40-305-contraction"].evaluate({"pressure": P, "fce_at": fce_at})
    for value, cell in zip(found["displacement"], printed(contractions)[0], strict=True):
        agree(value, cell, 1e-3)
    if fce_at == "xmax":
        r2, a, b = 4e-4, 3 / math.tan(math.radians(26.5)) ** 2, 1 / math.sin(math.radians(26.5)) ** 2
        force = math.pi * r2 * P * (a * (1 - found["displacement"] / 0.305) ** 2 - b)
        np.testing.assert_allclose(force, found["force_ce"], rtol=1e-9)


def test_other_braid_angle_of_the_dmsp():
    given = {"pressure": 6e5, "braid_angle": math.radians(25.3)}
    model = MODELS["dmsp-40-305-contraction"]
    assert float(model.evaluate(given)["displacement"]) * 1e3 == pytest.approx(86, abs=0.5)
    found = model.evaluate({**given, "fce_at": "xmax"})
    assert float(found["displacement"]) * 1e3 == pytest.approx(45.7, abs=0.05)


def test_a_load_that_is_not_lifted_is_refused():
    with pytest.raises(OutsideDomain, match="load"):
        MODELS["dmsp-40-305-contraction"].evaluate({"load": 5400.0})
    with pytest.raises(OutsideDomain, match="stretched"):
        MODELS["step-response"].evaluate({"load": 276.0})


def test_serres_is_refused_where_it_would_pull_without_pressure():
    with pytest.raises(OutsideDomain, match="without pressure"):
        MODELS["mas-20-250-serres2009"].evaluate({"pressure": 100e3})


def test_a_step_solves_the_equation_of_motion_without_mass():
    t = np.linspace(0, 2, 2001)
    given = {"force_ce": 275.0, "load": 60.0, "stiffness": 6.8e3, "damping": 1.7e3}
    x = MODELS["step-response"].evaluate({**given, "time": t, "dead_time": 0.04})["displacement"]
    assert (x[t <= 0.04] == 0).all()
    inner = slice(60, -1)
    speed = np.gradient(x, t)
    np.testing.assert_allclose((1.7e3 * speed + 6.8e3 * x)[inner], 215, atol=0.01)
    balance = MODELS["three-element"].evaluate({**given, "displacement": x, "speed": speed, "mass": 1.0})
    np.testing.assert_allclose(balance["acceleration"][inner], 0, atol=0.01)


# -- paper 3 ---------------------------------------------------------------------------------------------------------


def test_daerden_with_alpha_2_and_no_rubber_is_tondu_lopez_and_does_the_work_of_its_volume():
    eps = np.linspace(0, 0.2, 21)
    force = MODELS["daerden-force"].evaluate({"contraction": eps, "alpha": 2.0, "A": 0.0})["force"]
    np.testing.assert_allclose(force, MODELS["tondu-lopez"].evaluate({"contraction": eps})["force"], rtol=1e-12)
    slope = MODELS["daerden-volume"].evaluate({"contraction": eps, "alpha": 2.0})["volume_slope"]
    np.testing.assert_allclose(force, 5e5 * slope / 0.2, rtol=1e-12)


def test_the_slope_of_the_volume_is_its_derivative_and_breaks_virtual_work_as_the_paper_accepts():
    model, h = MODELS["daerden-volume"], 1e-6
    eps = np.array([-0.02, 0.0, 0.1, 0.19])
    ends = [model.evaluate({"contraction": eps + side})["volume"] for side in (h, -h)]
    slope = model.evaluate({"contraction": eps})["volume_slope"]
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / (2 * h), rtol=1e-7)
    section = MODELS["daerden-force"].evaluate()["section"]
    assert float(slope[1]) / 0.2 / float(section) == pytest.approx(1.337, abs=5e-4)


def test_the_rubber_term_holds_its_factor_of_contraction():
    found = MODELS["daerden-force"].evaluate({"contraction": [0.0, -0.03], "pressure": 3e5})
    assert found["rubber_force"][0] == 0
    assert found["rubber_force"][1] / found["force"][1] == pytest.approx(0.41, abs=0.005)


def test_the_inverse_model_returns_the_pressure():
    eps, P = np.meshgrid(np.linspace(-0.03, 0.2, 24), np.linspace(2e5, 8e5, 7))
    force = MODELS["daerden-force"].evaluate({"contraction": eps, "pressure": P})["force"]
    back = MODELS["daerden-inverse"].evaluate({"contraction": eps, "force": force})["pressure"]
    np.testing.assert_allclose(back, P, rtol=1e-9)


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"contraction": 0.2, "braid_angle": math.radians(45)}, "not above 0"),
        ({"contraction": -0.03, "force": 100.0}, "rubber alone pulls more"),
    ],
)
def test_the_inverse_model_refuses_what_no_pressure_gives(given, reason):
    with pytest.raises(OutsideDomain, match=reason):
        MODELS["daerden-inverse"].evaluate(given)


def test_a_closed_volume_is_found_from_gauge_pressures_by_the_law_of_gases():
    V, P, atm = 62.8e-6, 3e5, 101325.0
    amount = (P + atm) * V
    for volume in (50e-6, 70e-6, 152e-6):
        gauge = amount / volume - atm
        found = MODELS["closed-volume"].evaluate({"pressure_start": P, "pressure": gauge, "volume_start": V})
        assert float(found["volume"]) == pytest.approx(volume, rel=1e-12)
        assert abs(V * P / gauge / volume - 1) > 0.03, "what gauge pressures would give is another volume"


def test_three_equal_cylinders_are_one():
    given = {f"diameter_{j}": 0.024 for j in (1, 2, 3)} | {f"height_{j}": 0.05 for j in (1, 2, 3)}
    found = MODELS["three-cylinder-volume"].evaluate({**given, "thickness": 1e-3})
    assert float(found["volume"]) == pytest.approx(math.pi * 0.011**2 * 0.15)
    with pytest.raises(OutsideDomain, match="diameter_2"):
        MODELS["three-cylinder-volume"].evaluate({**given, "diameter_2": 2e-3, "thickness": 1e-3})


# -- coefficients of one's own -----------------------------------------------------------------------------------


def test_own_polynomials_make_the_table_of_paper0_and_the_published_muscle_too():
    P = np.array([100.0, 200, 300, 400, 500, 550]) * 1e3
    own = MODELS["polynomial-coefficients"].evaluate({"pressure": P})
    fixed = MODELS["mas-20-250-paper0"].evaluate({"pressure": P})
    for name in own:
        np.testing.assert_allclose(own[name], fixed[name], rtol=1e-12)
    for kpa, x, tau_c, tau_r in ((100, 10.18, 0.235, 0.248), (400, 50.72, 0.244, 0.326), (550, 59.99, 0.229, 0.327)):
        row = list(P).index(kpa * 1e3)
        assert own["displacement"][row] * 1e3 == pytest.approx(x, abs=5.1e-3)
        assert own["tau_contract"][row] == pytest.approx(tau_c, abs=5.1e-4)
        assert own["tau_relax"][row] == pytest.approx(tau_r, abs=5.1e-4)


@pytest.mark.parametrize(
    ("name", "given", "reason"),
    [
        ("polynomial-coefficients", {"damping_relax_1": -4.0}, "damping would be negative"),
        ("polynomial-coefficients", {"damping_contract_0": -2e3}, "damping would be negative"),
        ("polynomial-coefficients", {"stiffness_0": -8e3}, "stiffness would not be above 0"),
        ("polynomial-coefficients", {"pressure": 99e3}, "hold from pressure_low"),
    ],
)
def test_a_fit_is_refused_where_it_does_not_hold(name, given, reason):
    with pytest.raises(OutsideDomain, match=reason):
        MODELS[name].evaluate(given)
