"""What can be changed about a plant's preset, by name; standard library only, so that options are checked for free."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Overrides:
    """What can be changed about a preset by name; None leaves it as it is."""

    friction: float | None = None
    """Factor on static and kinetic friction, or on the hysteresis [1]; 0 for none."""
    F_s: float | None = None
    """Static friction [N]."""
    F_c: float | None = None
    """Kinetic friction [N]."""
    hysteresis: float | None = None
    """Half the gap of the loop that knows no rate [N]; plant `daerden`."""
    relaxes: float | None = None
    """Share of the pressure that rubber no longer passes on as force, per decade of time [1]; plant `daerden`."""
    noise: float | None = None
    """Factor on the noise of all sensors [1]; 0 for none."""
    regulator_lag: float | None = None
    """First-order lag of the pressure regulator [s]."""
    natural_frequency: float | None = None
    """Of a regulator of second order, in place of the lag [Hz]."""
    damping_ratio: float | None = None
    """Of a regulator of second order [1]."""
    dead_time: float | None = None
    """Transport time between command and regulator [s]."""
    vent_ratio: float | None = None
    """Lag while venting by lag while filling [1]."""
    dead_band: float | None = None
    """Pressure error that the regulator does not act on [Pa]."""
    leak: float | None = None
    """Share of the pressure that a leak takes away per second [1/s]; needs a lag above 0 to be seen."""
    conductance_fill: float | None = None
    """Air that the regulator lets in by the pressure that is missing [kg/(s Pa)]; plants `daerden`, `paper0-air`."""
    conductance_vent: float | None = None
    """Air that it lets out by the pressure that is too much [kg/(s Pa)]; with both 0 the motion does not matter."""
    polytropic: float | None = None
    """Exponent of the air: 1 where heat comes in at once, 1.4 where none does; `daerden`, `paper0-air`."""
    hose: float | None = None
    """Volume between regulator and muscle that is filled with it [m3]; plant `daerden`."""
    parallel: float | None = None
    """Like muscles side by side at a driven end [1]: their forces and volumes add up; not for plant `real`."""
    hysteresis_x: float | None = None
    """Factor on the hysteresis over contraction [1]; plant `real`, as the next four."""
    hysteresis_p: float | None = None
    """Factor on the hysteresis over pressure [1]."""
    creep: float | None = None
    """Factor on the creep [1]."""
    bend: float | None = None
    """Factor on the bend of the force over contraction [1]; 0 makes it straight."""
    first_cycle: float | None = None
    """Share by which the hysteresis over contraction is higher in the first cycle [1]; 0.6 is usual, 0 the preset's."""
    follow_lag: float | None = None
    """First-order lag of the displacement actuator [s]."""
    fce_eval: str | None = None
    """Where F_ce is taken, plant `dmsp-40-305`: `x0` at no contraction, `xmax` where it comes to, as in paper 1."""
    b_relax: str | None = None
    """`b_contract`: the damping of contraction in both directions."""
