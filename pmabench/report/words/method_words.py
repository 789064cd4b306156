"""What each method of the reductions does, in a sentence or two; a new method needs no entry, but deserves one."""

from __future__ import annotations

_DIFFERENCE = "Difference of two independent tests of the same specimen; their intervals are added as squares."
METHODS: dict[str, str] = {
    "measured-pressure": "One least-squares fit over short moving segments of all trials together, both strokes: "
    "M x″ + B(P) x′ + K(P) x + F_c sign x′ = F_ce(P) − F_L, driven by the pressure that was measured. "
    "K, B_c, B_r and F_ce are values at the tested pressures with straight lines between.",
    "joint": "The same least-squares fit with the forms over pressure that were asked for (constant, line, polynomial "
    "of a given or chosen order) from the lowest tested pressure up; its residual beside that of straight lines "
    "between pressures tells whether the forms are enough.",
    "output-error": "The coefficients of measured-pressure polished: each stroke is simulated with them under the "
    "measured pressure and force, and the error of the contraction, whitened for its serial correlation, is made least "
    "(Gauss-Newton).",
    "regulator-response": "Dead time and one lag, or two where the corrected Akaike criterion asks for them, fitted to "
    "the mean step of the measured pressure at each pressure, over the time since the command.",
    "bandwidth, by coefficients": "Where the gain from the pressure command to small contractions first falls by 3 dB: "
    "the regulator's lags, fitted to the steps of the measured pressure, and K, (B_c + B_r)/2 and the moving mass M. "
    "The interval holds those of K, B and the lags, and half of what B_c and B_r alone would make; no friction.",
    "bandwidth, by steps": "The same from recorded steps without a model: the gain is that of the step's own Fourier "
    "integral, G = 1 − jω ∫ (1 − y) e^(−jωt) dt, with y the contraction from its start to its rest. Such steps are "
    "larger than small signals and relax only.",
    "bandwidth, by sines of command": "Where the gain of recorded sines from commanded pressure to contraction has "
    "fallen by 3 dB from that of the slowest; between two frequencies 1/|G|² is a line over f², as it is for one lag.",
    "bandwidth, by sines of pressure": "The same with the measured pressure, for want of its command: that of the "
    "muscle alone.",
    "step-exponential": "The way of papers 0 and 1: K and F_ce from final contractions over loads, B = K τ with τ from "
    "an exponential through the displacement. It takes the pressure for a step, so B comes out too large where the "
    "regulator is slow; kept for comparison with published values.",
    "step-exponential, F_ce known": "K from final contractions alone, with F_ce taken from the static-load study or "
    "from the primary fit.",
    "paper-1-x0": "The way of paper 1: K = S = (F_ce − L) / x_max and B = D = τ S from single steps, "
    "τ from the first motion to 63.2 % of the stroke, F_ce from the braid's geometry at zero contraction. B_r carries "
    "the pressure before the release: a reduction, no coefficient at that pressure.",
    "paper-1-xmax": "The same with F_ce where the contraction ends, as paper 1 takes it: a convention of "
    "its own. K and B come out several times lower and belong to that F_ce alone.",
    "measured-pressure-x0": "One least-squares fit over short moving segments of all contractions "
    "together, driven by the pressure that was measured, with F_ce from the braid's geometry: "
    "M x″ + B_c(P) x′ + K(P) x = F_ce(P) − L. All move one way, so friction counts as less "
    "F_ce; a step to 0 says nothing of B_r at pressure.",
    "closed form of paper 1": "x_max (1 − e^(−t/τ)) and x_max e^(−t/τ_r) with the polynomials of the first method, "
    "begun at the mean dead time. Accuracy 100 (1 − |x_s − x_e| / x_e) compares the ends alone; the residual, all "
    "samples.",
    "static-mean": "F_ce(P) from the mean of the pressures at which each load lifts off its support and sets down "
    "again: friction acts in opposite directions and drops out. Least squares of pressure on load.",
    "static-lift": "As static-mean, from the lift-off alone: F_ce comes out low by the friction.",
    "static-set-down": "As static-mean, from the set-down alone: F_ce comes out high by the friction.",
    "static-half-difference": "Half the difference of lift-off and set-down, as a force: friction between sliding and "
    "static.",
    "onset": "Dead times from the first sample that leaves the noise: of pressure after the command, and of "
    "displacement after pressure and after the command.",
    "sine-harmonic": "Three-parameter sine fits (IEEE 1057) of measured displacement and force at the known frequency: "
    "K = −Re(F/x); −Im(F/x) A = B ω A + 4 F_c/π, a straight line over the speed ω A.",
    "loop-width": "Width of the force–displacement loop at mid stroke, 2 B ω A + 2 F_c, a straight line over the speed "
    "ω A. What is left at 0 Hz is true hysteresis; the rest is phase lag.",
    "sine-mean": "Mean force over whole cycles plus K times the mean displacement, a straight line over the speed ω A, "
    "at 0 Hz: friction cancels over a cycle, and where B_c and B_r differ the line rises by (B_r − B_c)/π.",
    "loop-work": "Work along the measured loop: W_c is the integral of F dx while contracting, eta its share of what "
    "is taken up while expanding, W_c + W. At held pressure the air takes part in both; what it carries in and "
    "out is not measured, so eta is no efficiency of the drive.",
    "step, relaxed": "Forces and measured contraction at rest, before a step of displacement and at the end of the "
    "rest after it: K = −ΔF/Δx; above 0 the step contracts.",
    "step, peak": "As step, relaxed, with the peak of the force in place of the relaxed one: damping, and the pressure "
    "that the step makes, are in it.",
    "step, recovery": "One exponential through force and pressure from the end of the motion on.",
    "closed, leak taken out": "P V^k of the air shut in is constant, P absolute, from the volume at the start of the "
    "stroke; what leaks into the room is told from the pressure back at the start. Mean of both directions.",
    "closed, as printed": "As closed, leak taken out, with no leak: V = V0 P0/P of paper 3.",
    "closed, V(eps)": "V = (π/4) D0² l0 [1/sin² θ0 − (1 − ε)^α/tan² θ0] (1 − ε) of paper 3, least squares through the "
    "volumes of all start pressures, what leaked taken out.",
    "pressure error": "Largest difference of measured and set pressure while moving in a direction, the mean over "
    "cycles.",
    "modelled with set pressure": "The force that a static model gives, F = f(x) + s(x) P through the branches of the "
    "slowest sines at all pressures, with damping and friction of the harmonics and the set pressure as input: what an "
    "ideal source of pressure would make of it (paper 3).",
    "modelled with measured pressure": "As modelled with set pressure, with the pressure that was measured.",
    "mean-curve": "Mean of the contracting and the expanding branch at constant pressure (paper 3), taken to speed 0 "
    "by a line over the speed. How the branches turn into each other is fitted to the gap between them, exponentially "
    "over the way, and taken off. K is minus the slope of a line through it, F_ce its force at x = 0.",
    "mean-curve, turns left in": "As mean-curve, the plain mean of the branches, as paper 3 has it: near the ends it "
    "still holds how one branch turns into the other.",
    "mean-curve, local": "As mean-curve, at places along the stroke by a cubic through the points around each.",
    "loop-gap": "Force while expanding minus force while contracting at mid stroke, above 0 where the contracting "
    "branch is the lower one: 2 F_c + (B_c + B_r) v, a straight line over the speed v. What is left at speed 0 is true "
    "hysteresis. W is the area of the loop, W_c the work given while contracting, eta its share of what is taken up "
    "while expanding; air is not measured, so eta is no efficiency of the drive.",
    "loop-gap, mean over the stroke": "As loop-gap, the mean of the gap over the stroke.",
    "loop-gap, open loop": "As loop-gap, the gap that the loop would open to on a long stroke, from the fit of how the "
    "branches turn into each other.",
    "rubber term": "F_e = A ε (ε − B1)/(ε + B2) (paper 3, eq. 8) by least squares through the mean curve at 0 kPa, ε "
    "by the nominal length.",
    "open-loop": "Steps of pressure to both sides of the operating point, no loop closed. A dead time and a lag are "
    "fitted from command to pressure, a gain, a lag for each direction and the inertia from the measured pressure to "
    "the contraction; K_u and T_u solve the phase equation ω L + Σ atan(ω T) = π of both, with the mean of the two "
    "directions (Ziegler and Nichols 1942). Where rests depend on the side they were reached from, as friction makes "
    "them, neither is told.",
    "gain-steps": "The gain of a proportional loop is raised in steps. The logarithm of the ratio of successive swings "
    "is fitted by a line over the gain; K_u is its zero (Ziegler and Nichols 1942). Oscillations that are no sine are "
    "refused.",
    "relay-fit": "A relay makes the loop swing at two sizes. A dead time, two lags and a gain are fitted to the "
    "harmonics of command, pressure and contraction of the larger one; K_u and T_u solve the phase equation of that "
    "loop. Where period or gain change with the size, as friction makes them, neither is told.",
    "relay-describing-function": "K_u = 4 d / (π √(a² − h²)), T_u the period of the relay oscillation: d half the "
    "switching of the command, a half the swing, h the hysteresis (Åström and Hägglund 1984). It leaves out harmonics "
    "and the phase of the hysteresis.",
    "closed-loop": "The position held by the controller: e_ss is the mean of set-point minus contraction in the "
    "stated window, over the set-point; rise from 10 to 90 % of it; cycles from one upward crossing of their middle to "
    "the next.",
    "closed-loop, simulated": "The same controller, sample by sample, around the model that the protocol names; e_sim "
    "is the rms difference of measured and simulated contraction from the step on.",
    "commanded pressure": "The way of paper 0: the model gets the pressure that was commanded. Errors are simulated "
    "minus measured contraction, means over the stated window; e_ss over the measured contraction, e_fs over the "
    "largest one.",
    "measured pressure": "As with the commanded pressure, but the model gets the pressure that was measured, so that "
    "the regulator's errors are none of the model's.",
    "recorded-step": "Dead time, rise time and stroke of each recorded step; pressure per contraction from its ends.",
    "ringing-of-known-mass": "M x″ + B x′ + K x = (dF_ce/dP) P + const, driven by the measured pressure, with the "
    "moving mass taken as exact: K = M ω², B = 2 D ω M.",
    "isometric-line": "One least-squares line F = m P + c through all usable samples above the force threshold, the "
    "tests of one contraction together; the interval is Student's t on the scatter between tests.",
    "force-threshold": "The pressure at which the force leaves its level at rest while filling and reaches it while "
    "emptying: the first sample beyond six times the noise (at least 0.2 N), followed back along the line through the "
    "next samples.",
    "isometric-sections": "Forces at one pressure over all contractions, a least-squares line F = F_ce − K x.",
    "blocked": "Force at the nominal length and set pressures, the mean of filling and emptying between neighbouring "
    "means over pressure; where contractions on both sides were tested, on a parabola through three. The method part "
    "is what a line would give, else the stiffness times what the muscle was off; a bend over pressure adds to it.",
    "isometric-sides": "Half the force after an approach from above minus after one from below: friction inside.",
    "daerden-section": "Least squares of S = (π/4) D0² [3 (1 − ε)^α / tan² θ0 − 1 / sin² θ0] through the slopes "
    "(paper 3). The intervals hold if S has this form; a parameter wider than ±25 % is not told.",
    "daerden-section, alpha = 2": "The same with α = 2, the force of Tondu and Lopez.",
    "daerden-section, D_0 of the specimen": "The same with D0 given by the specimen's inner_diameter.",
    "daerden-section, theta_0 of the specimen": "The same with θ0 given by the specimen's braid_angle.",
    "corrected-force": "F = π r0² (p − p0) [a (1 − q ε)² − b], q = 1 + e^(−p/bar), with p0 by least squares over all "
    "contractions, D0 and θ0 of the specimen (paper 2).",
    "free-length": "Nominal length less the contraction at rest, the mean over the last fifth of each hold and of both "
    "sides from which the pressure was reached (from 0, and from the highest pressure). P_half is where half of the "
    "contraction at the highest pressure is reached, by monotone cubics through the points.",
    "sigmoid": "L = a + b / [1 + (p/c)^d]^e − 0.009 L0 √p (paper 2, eq. 1) by least squares through the lengths at all "
    "pressures; intervals by the profile of the sum of squares, if L has this form.",
    "angle-at-rest": "Mean over the last fifth of each hold; α0 and αmax on the way up, as in paper 2. P_flat by "
    "monotone cubics through the way up; αH where it is widest. The method part of αmax holds half of αH: at the top "
    "one way only is known.",
    "logistic-up": "α = a + b / [1 + (p/c)^d] (paper 2, second eqs. 10) by least squares through the way up, as paper "
    "2 does; intervals by the profile of the sum of squares, if α has this form.",
    "logistic-mean": "The same through the mean of both ways.",
    "logistic-loads": "The same with a, b, c, d as powers of the load up to the fourth, through the ways up of all "
    "loads at once: paper 2's 20 numbers.",
}
"""Method -> what it does, in a sentence or two."""


def described(method: str) -> str:
    """What a method does; empty for one that is not known.

    What stands after ` above ` is a limit of it; after `, ` the way of one side of a comparison.
    """
    known = (METHODS.get(name) for name in (method, method.partition(" above ")[0], method.partition(", ")[0]))
    return next((words for words in known if words), _DIFFERENCE if " against " in method else "")
