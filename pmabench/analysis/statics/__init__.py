"""Tests at rest: force, contraction, volume and bending angle over pressure and load.

- static-load: `static_load`, made of `static_load_points`, `break_away` (lift and set-down carried to x = 0)
- free-contraction: `free_contraction`; arm-angle: `arm_angle`, on `arm_stairs`
- isometric-pressurisation: `isometric_pressurisation`, made of `isometric_lines`, `isometric_curve`, `section` (S over
  contraction), `isometric_sections` (all contractions at one pressure), `blocked_force`
- closed-volume: `closed_volume`, made of `closed_stroke`, `volume_fit`
- `..._view`: words and figures of a reduction
"""
