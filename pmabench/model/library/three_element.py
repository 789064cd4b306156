"""The three-element model with given coefficients, as in papers 0, 1 and 4: balance, steps, release."""

from __future__ import annotations

import numpy as np

from pmabench.model.curve import Array
from pmabench.model.library.description import INF, Output, Parameter, Reference, Values, described, refuse

FAMILY = "three-element"
MM = 1e-3

FORCE_CE = Parameter("force_ce", "F_ce", "force", 275.0, "contractile force at x = 0", 0.0, INF, "a muscle cannot push")
LOAD = Parameter("load", "F_L", "force", 0.0, "load", 0.0, INF, "a load that pushes is no load of a muscle")
STIFFNESS = Parameter("stiffness", "K", "stiffness", 6.773e3, "stiffness", 0.0, above=True)
DAMPING = Parameter("damping", "B", "damping", 1.68e3, "damping", 0.0, INF, "damping is never negative")
TIME = Parameter("time", "t", "time", 1.0, "time since the step", 0.0, INF, "the step is at 0")
MASS = Parameter("mass", "M", "mass", 0.5, "moving mass", 0.0, above=True)
TAU = Output("tau", "tau", "time", "time constant B / K")
DISPLACEMENT = Output("displacement", "x", "length", "contraction")


@described(
    "three-element", FAMILY, "Acceleration and force of mass, damper and spring (paper 0)",
    equation=("M x'' + B x' + K x = F_ce - F_L", "F = F_ce - K x - B x' (what the cell at the fixed end reads)"),
    source="paper 0 eq. 2; paper 1 without the mass",
    fitted=("force_ce", "stiffness", "damping"),
    parameters=(
        FORCE_CE, LOAD, STIFFNESS, DAMPING, MASS,
        Parameter("displacement", "x", "length", 20 * MM, "contraction", 0.0, 1.0, "it is stretched"),
        Parameter("speed", "x'", "speed", 0.0, "rate of contraction"),
    ),
    outputs=(
        Output("acceleration", "x''", "acceleration", "acceleration of contraction"),
        Output("force", "F", "force", "force at the fixed end; F_L at rest"),
        Output("final", "x_inf", "length", "contraction at rest, (F_ce - F_L) / K"),
    ),
    references=(
        Reference("force", "139.54", "N", 1.0, "by hand: 275 - 6.773 20"),
        Reference("acceleration", "279.08", "m/s2", 1.0, "by hand: 139.54 / 0.5"),
        Reference("final", "40.60", "mm", MM, "table of plant paper0 at 300 kPa, 0 N"),
    ),
    notes=(
        "Paper 0 means F_ce at zero contraction; paper 1 takes it at x_max: see dmsp-40-305-contraction.",
        "In the contraction section paper 0 prints K for the damping coefficient; B is meant.",
    ),
)  # fmt: skip
def three_element(
    force_ce: Array, load: Array, stiffness: Array, damping: Array, mass: Array, displacement: Array, speed: Array
) -> Values:
    """Outputs x'' [m/s2], F [N], x_inf [m] from F_ce, F_L [N], K [N/m], B [N.s/m], M [kg], x [m], x' [m/s]."""
    force = force_ce - stiffness * displacement - damping * speed
    final = np.maximum(force_ce - load, 0) / stiffness
    return {"acceleration": (force - load) / mass, "force": force + 0 * load, "final": final}


@described(
    "step-response", FAMILY, "Contraction after a step of pressure from rest, without mass",
    equation=("x = x_inf (1 - exp(-(t - t_d) / tau)) for t >= t_d, else 0;  x_inf = (F_ce - F_L) / K;  tau = B / K",),
    source="paper 0, contraction study; paper 1: closed form of the equation without mass",
    fitted=("stiffness", "damping", "dead_time"),
    parameters=(
        TIME, FORCE_CE, LOAD, STIFFNESS, DAMPING,
        Parameter("dead_time", "t_d", "time", 0.0, "from the step to the first motion", 0.0),
    ),
    outputs=(DISPLACEMENT, Output("final", "x_inf", "length", "contraction at rest"), TAU),
    references=(
        Reference("displacement", "0.63212", "m", 1.0, "closed form: 1 - 1/e of x_inf = 1 m",
                  {"force_ce": 1e3, "stiffness": 1e3, "damping": 1e3}),
        Reference("displacement", "0.98168", "m", 1.0, "closed form: 1 - exp(-4)",
                  {"force_ce": 1e3, "stiffness": 1e3, "damping": 1e3, "time": 4.0}),
        Reference("tau", "0.248", "s", 1.0, "table of plant paper0 at 300 kPa"),
    ),
    notes=(
        "Holds for M far below B^2 / (4 K), constant pressure, and a load below F_ce; a hanging load is mass: 46 kg on "
        "a MAS-20 make the fitted tau 9 % short.",
        "A single exponential fitted behind a real regulator gives B 11 to 80 % too high: fit with the measured "
        "pressure.",
    ),
)  # fmt: skip
def step_response(
    time: Array, force_ce: Array, load: Array, stiffness: Array, damping: Array, dead_time: Array
) -> Values:
    """Outputs x and x_inf [m], tau [s] from t [s], F_ce and F_L [N], K [N/m], B [N.s/m], t_d [s]."""
    refuse("load", "a load above F_ce is not lifted: the muscle would be stretched", load > force_ce, load)
    refuse("damping", "it must be above 0: without damping there is no time constant", damping <= 0)
    final, tau = (force_ce - load) / stiffness, damping / stiffness
    since = np.maximum(time - dead_time, 0)
    return {"displacement": -final * np.expm1(-since / tau), "final": final + 0 * tau, "tau": tau + 0 * final}


@described(
    "release-response", FAMILY, "Relaxation after the pressure is let off, without mass",
    equation=("x = x0 exp(-t / tau_r);  tau_r = B_r / K",),
    source="paper 1, relaxation",
    fitted=("displacement_start", "damping"),
    parameters=(
        TIME,
        Parameter("displacement_start", "x0", "length", 40 * MM, "contraction before", 0.0),
        STIFFNESS,
        Parameter(
            "damping", "B_r", "damping", 2.12e3, "damping of relaxation", 0.0, INF, "damping is never negative",
            above=True,
        ),
    ),
    outputs=(DISPLACEMENT, TAU),
    references=(
        Reference("tau", "0.313", "s", 1.0, "table of plant paper0 at 300 kPa"),
        Reference("displacement", "0.36788", "m", 1.0, "closed form: 1/e of 1 m",
                  {"displacement_start": 1.0, "stiffness": 1e3, "damping": 1e3}),
    ),
    notes=("Paper 1 indexes the coefficients of relaxation by the pressure before the release.",),
)  # fmt: skip
def release_response(time: Array, displacement_start: Array, stiffness: Array, damping: Array) -> Values:
    """Outputs x [m], tau_r [s] from t [s], x0 [m], K [N/m], B_r [N.s/m]."""
    tau = damping / stiffness
    return {"displacement": displacement_start * np.exp(-time / tau), "tau": tau}
