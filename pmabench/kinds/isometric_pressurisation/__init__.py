"""Force over pressure at set contractions: slopes, S(eps), dead band, hysteresis, F_ce and K.

- `reduction`, made of `curve` (force over pressure at one contraction, and where it begins), `sections` (all
  contractions at one pressure), `braid` (S over contraction), `flow` (volume by a mass flow meter)
- `form`: whether the tests have the assumed form, and zero errors that show at rest
- protocol files: `protocol`; one trial on the display: `reduction`
"""

from pmabench.base.kind import Commanded, Imported, Kind, Result

RESULTS = (
    Result("F_ce", "contractile force", "force", headline=True),
    Result("F_b", "blocked force", "force", headline=True),
    Result("K", "stiffness", "stiffness", headline=True, positive=True),
    Result("F_f", "friction, half the difference of both directions", "force", positive=True),
    Result("H", "loop width", "force"),
    Result("F", "force", "force"),
    Result("m", "slope of force over pressure", "force per pressure", headline=True),
    Result("c", "intercept of force over pressure", "force"),
    Result("p_0", "pressure at which the force begins", "pressure", headline=True),
    Result("D_0", "free diameter", "length", headline=True),
    Result("theta_0", "braid angle at the nominal length", "angle", headline=True),
    Result("alpha", "exponent of S(ε)", "count", headline=True),
    Result("V", "volume inside the muscle", "volume", headline=True),
    Result("q", "mass flow of air while filling", "mass flow"),
)
METHODS = {
    "isometric-line": (
        "One line over pressure: F = m P + c, by least squares through all usable samples above the force threshold, "
        "the tests of one contraction together, of a staircase the second half of each hold; the interval is Student's "
        "t on the scatter between tests."
    ),
    "force-threshold": (
        "The pressure at which the force leaves its level at rest while filling and reaches it while emptying: the "
        "first sample beyond six times the noise (at least 0.2 N), followed back along the line through the next "
        "samples."
    ),
    "isometric-sections": "Forces at one pressure over all contractions, a least-squares line F = F_ce − K x.",
    "blocked": (
        "Force at the nominal length and set pressures, the mean of filling and emptying between neighbouring means "
        "over pressure; where contractions on both sides were tested, on a parabola through three. The method part is "
        "what a line would give, else the stiffness times what the muscle was off; a bend over pressure adds to it."
    ),
    "isometric-sides": "Half the force after an approach from above minus after one from below: friction inside.",
    "daerden-section": (
        "Least squares of S = (π/4) D0² [3 (1 − ε)^α / tan² θ0 − 1 / sin² θ0] through the slopes (paper 3). The "
        "intervals hold if S has this form; a parameter whose interval is wider than ±25 % is withheld."
    ),
    "daerden-section, D_0 of the specimen": "The same with D0 given by the specimen's inner_diameter.",
    "mass flow, filling": (
        "V = r T ∫q dt/ΔP − V_dead over the ramp up and the rest at its top, r 287 J/(kg K); the zero of the meter, "
        "its mean before and after both ramps, is taken off."
    ),
    "mass flow, mean while filling": "Mean of the measured flow from 15 to 95 % of the ramp up, its zero taken off.",
}
PHASES = (("up to the highest", "fill"), ("down from the highest", "empty"), ("any", "rest"))
"""Command of an import -> name of its phase; the last entry is for all other commands."""
KIND = Kind(
    name="isometric-pressurisation",
    title="Isometric pressurisation",
    order=100,
    results=RESULTS,
    reduction="pmabench.kinds.isometric_pressurisation.reduction:reduce",
    papers=("paper 2", "paper 3", "paper 4"),
    protocol="pmabench.kinds.isometric_pressurisation.protocol:IsometricPressurisation",
    live="pmabench.kinds.isometric_pressurisation.reduction:measure",
    moves="force",
    repeated="pmabench.kinds.isometric_pressurisation.curve:largest_force",
    repeated_is="largest force",
    word="isometric",
    offers="pmabench.kinds.isometric_pressurisation.reduction:offers",
    methods=METHODS,
    figures={
        "isometric": "pmabench.plotting.motion:isometric",
        "section": "pmabench.kinds.isometric_pressurisation.braid:pictures",
    },
    front={"isometric": "pmabench.plotting.motion:isometric"},
    published={"isometric": ("pressure", "force", "displacement")},
    parts={"slow rows": "pmabench.analysis.surface.trials:driven"},
    imported=Imported(
        Commanded("pressure", phases=PHASES, point=(("contraction", "length"),)),
        follows="force",
        shown="held lengths",
    ),
)
