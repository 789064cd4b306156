"""Changes to a plant's preset, by name; standard library only, so that checking options is fast."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Overrides:
    """Changes to a preset by name; None for no change."""

    friction: float | None = None
    """Factor on static and kinetic friction, or on the hysteresis [1]; 0 for none."""
    F_s: float | None = None
    """Static friction [N]."""
    F_c: float | None = None
    """Kinetic friction [N]."""
    hysteresis: float | None = None
    """Half width of the rate-independent hysteresis loop [N]; plant `daerden`."""
    relaxes: float | None = None
    """Relaxation of the rubber: share of the pressure lost as force per decade of time [1]; plant `daerden`."""
    noise: float | None = None
    """Factor on the noise of all sensors [1]; 0 for none."""
    regulator_lag: float | None = None
    """First-order lag of the pressure regulator [s]."""
    natural_frequency: float | None = None
    """Natural frequency of a second-order regulator, in place of the lag [Hz]."""
    damping_ratio: float | None = None
    """Damping ratio of a second-order regulator [1]."""
    dead_time: float | None = None
    """Transport time between command and regulator [s]."""
    vent_ratio: float | None = None
    """Ratio of the lags for venting and filling [1]."""
    dead_band: float | None = None
    """Dead band of the regulator: pressure error without reaction [Pa]."""
    leak: float | None = None
    """Relative loss of pressure by a leak [1/s]; has an effect only with a lag above 0."""
    conductance_fill: float | None = None
    """Mass flow of the filling regulator per pressure difference [kg/(s Pa)]; plants `daerden`, `paper0-air`."""
    conductance_vent: float | None = None
    """Mass flow of the venting regulator per pressure difference [kg/(s Pa)]; with both 0 no effect of motion."""
    polytropic: float | None = None
    """Polytropic exponent of the air: 1 isothermal, 1.4 adiabatic; `daerden`, `paper0-air`."""
    hose: float | None = None
    """Volume of the hose between regulator and muscle [m3]; plant `daerden`."""
    parallel: float | None = None
    """Number of equal muscles in parallel at a driven end [1]: forces and volumes add up; not for plant `real`."""
    hysteresis_x: float | None = None
    """Factor on the hysteresis over contraction [1]; plant `real`, as the next four."""
    hysteresis_p: float | None = None
    """Factor on the hysteresis over pressure [1]."""
    creep: float | None = None
    """Factor on the creep [1]."""
    bend: float | None = None
    """Factor on the curvature of the force over contraction [1]; 0 makes it linear."""
    first_cycle: float | None = None
    """Relative increase of the hysteresis over contraction in the first cycle [1]; 0.6 is usual, the preset has 0."""
    follow_lag: float | None = None
    """First-order lag of the displacement actuator [s]."""
    fce_eval: str | None = None
    """Contraction at which F_ce is evaluated, plant `dmsp-40-305`: `x0` zero, `xmax` the final one, as in paper 1."""
    b_relax: str | None = None
    """`b_contract`: use the damping of contraction in both directions."""
