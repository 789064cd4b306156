"""Contraction and relaxation under load: K(P), B_c(P), B_r(P), F_ce(P), dead times.

- `reduction`, made of `segments` (trials and their segments), `pooled`, `intervals`, `values` (and regressions on
  pressure)
- whether the data have the form of the fit, why not, and what could hide in it: `diagnosis`; other checks of the fit,
  its words and overlays: `checks`
- the way of the papers, dead times: `exponentials`; the regulator, and how late its gauge is: `bandwidth`
- by paper 1: `paper1`
- further trials: `known`, what is known so far and what they would add; `next_trial`, the choice
- protocol files: `protocol`; one trial on the display: `reduction`
"""

from pmabench.base.kind import Commanded, Imported, Kind, Result

RESULTS = (
    Result("F_ce", "contractile force", "force", headline=True),
    Result("K", "stiffness", "stiffness", headline=True, positive=True),
    Result("B_c", "damping, contracting", "damping", headline=True, plot="Damping", positive=True),
    Result("B_r", "damping, relaxing", "damping", headline=True, plot="Damping", positive=True),
    Result("F_c", "Coulomb friction", "force", headline=True, positive=True),
    Result("tau_c", "time constant, contracting", "time", plot="Time constants", positive=True),
    Result("tau_r", "time constant, relaxing", "time", plot="Time constants", positive=True),
    Result("t_d", "dead time", "time", plot="Dead times t_d", positive=True),
    Result("f_b", "bandwidth under commanded pressure, −3 dB", "frequency", positive=True),
    Result("tau_P", "rise time of the pressure", "time", positive=True),
)
PAPER_1_RESULTS = (
    *RESULTS[:8],
    Result("accuracy", "agreement of model and test at rest", "ratio", plot="Accuracy of the closed form at rest"),
    Result("misfit", "residual of the model over time", "length", plot="Residual of the closed form, rms over time"),
)
METHODS = {
    "measured-pressure": (
        "One least-squares fit over short moving segments of all trials together, both strokes: M x″ + B(P) x′ + K(P) x"
        " + F_c sign x′ = F_ce(P) − F_L, driven by the pressure that was measured. K, B_c, B_r and F_ce are values at "
        "the tested pressures with straight lines between."
    ),
    "regulator-response": (
        "Dead time and one lag, or two where the corrected Akaike criterion asks for them, fitted to the mean step of "
        "the measured pressure at each pressure, over the time since the command. A lag as long as that of the gauge, "
        "declared or found, is that of its filter and left out; without one the gauge counts as late by it."
    ),
    "bandwidth, by coefficients": (
        "Where the gain from the pressure command to small contractions first falls by 3 dB: the regulator's lags, "
        "fitted to the steps of the measured pressure, and K, (B_c + B_r)/2 and the moving mass M. The interval holds "
        "those of K, B and the lags, and half of what B_c and B_r alone would make; no friction."
    ),
    "step-exponential": (
        "The way of papers 0 and 1: K and F_ce from final contractions over loads, B = K τ with τ from an exponential "
        "through the displacement. It takes the pressure for a step, so B comes out too large where the regulator is "
        "slow; kept for comparison with published values."
    ),
    "paper-1-x0": (
        "The way of paper 1: K = S = (F_ce − L) / x_max and B = D = τ S from single steps, τ from the first motion to "
        "63.2 % of the stroke, F_ce from the braid's geometry at zero contraction. B_r carries the pressure before the "
        "release: a reduction, no coefficient at that pressure."
    ),
    "paper-1-xmax": (
        "The same with F_ce where the contraction ends, as paper 1 takes it: another convention. K and B come out "
        "several times lower and belong to that F_ce alone."
    ),
    "measured-pressure-x0": (
        "One least-squares fit over short moving segments of all contractions together, driven by the pressure that was"
        " measured, with F_ce from the braid's geometry: M x″ + B_c(P) x′ + K(P) x = F_ce(P) − L. All move one way, so "
        "friction counts as less F_ce; a step to 0 says nothing of B_r at pressure."
    ),
    "closed form of paper 1": (
        "x_max (1 − e^(−t/τ)) and x_max e^(−t/τ_r) with the polynomials of the first method, begun at the mean dead "
        "time. Accuracy 100 (1 − |x_s − x_e| / x_e) compares the ends alone; the residual, all samples."
    ),
    "onset": (
        "Dead times from the first sample that leaves the noise: of pressure after the command, and of displacement "
        "after pressure and after the command."
    ),
}
PAPER_1 = Kind(
    name="contraction-relaxation-paper-1",
    title="Contraction and relaxation in single steps",
    order=21,
    results=PAPER_1_RESULTS,
    reduction="pmabench.kinds.contraction_relaxation.paper1:reduce",
    papers=("paper 1, section 3",),
    moves="displacement",
    word="contraction",
    offers="pmabench.kinds.contraction_relaxation.values:by_paper_1",
    figures={"step-overlay": "pmabench.kinds.contraction_relaxation.paper1:step_overlays"},
)
KIND = Kind(
    name="contraction-relaxation",
    title="Contraction and relaxation",
    order=20,
    results=RESULTS,
    reduction="pmabench.kinds.contraction_relaxation.reduction:reduce",
    papers=("paper 0, section 4", "paper 1, section 3"),
    protocol="pmabench.kinds.contraction_relaxation.protocol:ContractionRelaxation",
    live="pmabench.kinds.contraction_relaxation.reduction:measure",
    moves="displacement",
    repeated="pmabench.analysis.shared.trials:stroke_of",
    repeated_is="stroke",
    word="contraction",
    offers="pmabench.kinds.contraction_relaxation.values:offers",
    methods=METHODS,
    options=("regulator",),
    parts={
        "intervals of a plan": "pmabench.kinds.contraction_relaxation.known:intervals_of_plan",
        "slow rows": "pmabench.analysis.surface.trials:hanging",
        "next trial": "pmabench.kinds.contraction_relaxation.next_trial:Chooser",
    },
    also=(PAPER_1,),
    figures={"overlay": "pmabench.plotting.motion:overlays"},
    front={"overlay": "pmabench.plotting.motion:overlays"},
    imported=Imported(
        Commanded(
            "pressure",
            phases=(("rises", "contract"), ("to the lowest", "vent"), ("any", "relax")),
            point=(("pressure", "highest"),),
        ),
        follows="displacement",
        loaded=True,
        shown="numbered trials",
    ),
)
