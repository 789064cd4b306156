"""Contraction on several days whose muscle differs by a little: a muscle of known coefficients, by small Euler steps."""

from dataclasses import replace

import numpy as np

from pmabench.analysis.verdict.checks import with_sessions
from pmabench.kinds.reduce import reduce_runs
from pmabench.store.analyses.results import Analysis, Estimate, Parts
from pmabench.store.records import Command, TrialData
from tests.analysis.judged_forms import as_run
from tests.analysis.test_contraction_sensors import HOLD, RATE, TRUE, pressed

CELLS = [(W, P) for W in (60.0, 130.0, 200.0) for P in (2e5, 3e5, 4e5) if TRUE["F_ce"](P) > W + 15]
FINE = 3


def day(number, stiffer=1.0, damped=1.0, friction=0.0):
    """A run of all cells; `friction` is Coulomb friction [N]."""
    t = np.arange(int((0.2 + 5 * HOLD) * RATE * FINE)) / (RATE * FINE)
    W, P = np.array(CELLS)[:, 0], np.array([pressed(t, target) for _, target in CELLS])
    F, K = TRUE["F_ce"](P), stiffer * TRUE["K"](P)
    up, down = damped * TRUE["B_c"](P), damped * TRUE["B_r"](P)
    x = np.zeros_like(P)
    for i in range(len(t) - 1):
        pull = F[:, i] - W - K[:, i] * x[:, i]
        pull = np.sign(pull) * np.maximum(np.abs(pull) - friction, 0.0)
        x[:, i + 1] = np.maximum(0.0, x[:, i] + (t[1] - t[0]) * pull / np.where(pull > 0, up[:, i], down[:, i]))
    chance, trials = np.random.default_rng(number), []
    for place, (weight, target) in enumerate(CELLS):
        rows = slice(0, int((0.2 + HOLD * (target / 1e5 + 1)) * RATE) * FINE, FINE)
        read = {"pressure": P[place, rows], "displacement": x[place, rows], "force": np.minimum(F[place, rows], weight)}
        read["force"] = np.where(read["displacement"] > 0, weight, np.maximum(read["force"], 0.0))
        noise = {"pressure": 250.0, "displacement": 3e-6, "force": 0.3}
        read = {name: values + noise[name] * chance.standard_normal(len(values)) for name, values in read.items()}
        levels, begin = np.arange(target, -1.0, -1e5), 30.0 * place
        commands = tuple(
            Command(begin + 0.2 + k * HOLD, "pressure", "set", float(to), float(levels[k - 1]) if k else 0.0,
                    "contract" if not k else "relax" if to > 0 else "vent", {})
            for k, to in enumerate(levels)
        )  # fmt: skip
        point = {"load": weight, "mass": 0.5, "pressure": target}
        flags = np.zeros(len(read["pressure"]), np.uint16)
        trials.append(
            TrialData(f"day{number}", place, point, 0, False, "finished", begin + t[rows], read, flags, commands, {})
        )
    return replace(as_run("contraction-relaxation", trials, RATE, {}), id=f"day{number}")


def values(analysis):
    return [e for e in analysis.estimates if e.method == "measured-pressure" and set(e.at) == {"pressure"}]


def test_days_that_differ_by_a_percent_have_means_with_their_scatter():
    """All values were withheld, "the cause is unknown", though each day has the form of the model by itself."""
    runs = [day(i, stiffer=share) for i, share in enumerate((1.012, 0.99, 0.998))]
    (analysis,) = reduce_runs(runs, {"contraction-relaxation": {"replays": 2}})
    given = [e for e in values(analysis) if e.value is not None]
    assert len(given) >= 10
    assert all(abs(e.value - TRUE[e.symbol](e.at["pressure"])) < e.parts.combined < 0.1 * e.value for e in given)
    assert not any(e.withheld for e in values(analysis))
    assert sum(f.text.startswith("the 3 sessions do not fit one muscle") for f in analysis.findings) == 1
    assert not any("the cause is unknown" in f.text for f in analysis.findings)
    assert analysis.facts["form"]["state"] == "sessions"
    assert not analysis.curves
    assert analysis.facts["trials_used"] == sum(len(run.trials) for run in runs)
    (alone,) = reduce_runs(runs[:1], {"contraction-relaxation": {"replays": 0}})
    assert not any("sessions" in f.text for f in alone.findings)


def test_what_each_day_lacks_as_much_is_no_difference_of_days():
    lost = Estimate("K", None, "N/m", "stiffness", "m", withheld=True)
    known = replace(lost, value=1.0, parts=Parts(0.1), withheld=False)

    def with_form(e, **form):
        return Analysis("contraction-relaxation", (), False, (e,), facts={"form": form} if form else {})

    def given(*alone):
        return with_sessions(with_form(lost, state="withheld", ratio=1.25, ratio_before=1.25), alone).estimates[0].value

    sound, poor = with_form(known, state="sound", ratio=1.0), with_form(known, state="withheld", ratio=2.0)
    assert given(sound, sound) == 1.0
    assert given(*2 * [with_form(known, state="sound", ratio=1.19)]) is None
    assert given(sound, poor) is None
    assert given(sound, with_form(known, state="corrected", ratio=1.0)) is None, "a bend has its K somewhere else"
    assert given(sound, with_form(known)) is None
    assert given(sound, with_form(lost, state="sound", ratio=1.0)) is None
