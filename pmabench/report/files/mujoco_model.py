"""An analysis as a MuJoCo file: one slide joint under an affine actuator, and how far that is off the fit.

The actuator's force is gain x control + bias with gain and bias affine in length and speed, which is the muscle's law
where F_ce, K and B are straight lines over the pressure: f_0 + f_1 P - (k_0 + k_1 P) x - (b_0 + b_1 P) v. It has one
damping for both directions. The deviation is found as for python-control, by running that law along measured trials.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmabench import __version__
from pmabench.analysis.results import Analysis
from pmabench.report.files.control_model import ControlModel, control_model, deviation_of, inside, remarks_of
from pmabench.store.records import Array, RunData

STEP = 0.0005
"""Time step of the file [s]."""
STIFF = "0.9999 0.9999 0.001"
"""Impedance of the joint's friction: with less of it a muscle at rest creeps."""
LINES = (("F_ce", "f"), ("K", "k"), ("B", "b"))


def mujoco_model(analysis: Analysis, runs: Sequence[RunData] = ()) -> ControlModel:
    """The model of `control_model` with each coefficient on one straight line; UsageError where it makes none.

    The lines are those of least squares through the values at the tested pressures. B is the mean of B_c and B_r.
    """
    model = control_model(analysis, runs)
    P = model.params["P"]
    ends = np.array([P[0], P[-1] if len(P) > 1 else P[0] + 1e5])
    values = {name: model.params[name] for name in ("F_ce", "K", "B_c", "B_r")}
    values["B"] = 0.5 * (values["B_c"] + values["B_r"])
    lines = {name: np.polyval(line_through(P, values[name]), ends) for name, _ in LINES}
    both = {"B_c": lines["B"], "B_r": lines["B"]}
    params = model.params | {"P": ends, "F_ce": lines["F_ce"], "K": lines["K"], **both}
    notes = [*model.notes, "one damping for both directions: the mean of B_c and B_r"]
    return replace(model, params=params, notes=notes, deviation=deviation_of(analysis, runs, params))


def line_through(P: Array, values: Array) -> Array:
    """Slope and intercept of least squares, shape (2,); a constant where there is one pressure."""
    return np.polyfit(P, values, 1) if len(P) > 1 else np.array([0.0, float(values[0])])


def mujoco_text(model: ControlModel, analysis: Analysis) -> str:
    """The MJCF file; the same bytes for the same analysis. Controls: pressure [Pa gauge] and load [N]."""
    P = model.params["P"]
    slopes = {}
    for symbol, name in (("F_ce", "f"), ("K", "k"), ("B_c", "b")):
        slope, start = line_through(P, np.asarray(model.params[symbol]))
        slopes[name] = (f"{start:.12g}", f"{slope:.12g}", f"{-start:.12g}", f"{-slope:.12g}")
    (f_0, f_1, *_), (*_, k_0, k_1), (*_, b_0, b_1) = slopes["f"], slopes["k"], slopes["b"]
    remarks = ["SIMULATED."] if analysis.simulated else []
    remarks += [f"A pneumatic muscle as fitted: method {inside(model.method)}, pmabench {__version__}; runs:"]
    remarks += [inside(run) for run in analysis.runs]
    remarks += [
        *remarks_of(model),
        f"It holds from {P[0] / 1e3:g} to {P[-1] / 1e3:g} kPa. Controls: pressure [Pa gauge] and load [N].",
        "The joint is the contraction [m]; the mass is the moving mass: put yours.",
    ]
    comment = "\n".join(f"  {line.replace('--', '- -')}" for line in remarks)
    mass, friction = (f"{model.params[name]:.12g}" for name in ("M", "F_c"))
    return f"""<mujoco model="pneumatic muscle">
  <!--
{comment}
  -->
  <option timestep="{STEP:g}" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <body name="end">
      <joint name="contraction" type="slide" axis="0 0 1" limited="true" range="0 1"
        frictionloss="{friction}" solimpfriction="{STIFF}"/>
      <geom type="sphere" size="0.02" mass="{mass}" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <general name="muscle" joint="contraction" gaintype="affine" biastype="affine"
      gainprm="{f_1} {k_1} {b_1}" biasprm="{f_0} {k_0} {b_0}"/>
    <motor name="load" joint="contraction" gear="-1"/>
  </actuator>
</mujoco>
"""
