"""Contraction and relaxation under load: K(P), B_c(P), B_r(P), F_ce(P), dead times.

- `contraction` reduces, made of `campaign`, `segments`, `segment_noise`, `pooled`, `replay`, `intervals`, `drift`,
  `contraction_values`, `curves` (regressions on pressure)
- whether the data have the form of the fit, and what could hide in it: `form`, with `departures` and `weights`
- the papers' way, dead times and bandwidth: `contraction_steps`, `steps`, `bandwidth`; words and figures:
  `contraction_view`; whole trials run freely: `free_run`
- where asked for: chosen forms over pressure in `contraction_joint`, `joint`, `forms`; output error in
  `contraction_polish`, `output_error`, `stretch`; draws over trials in `bootstrap`; the regulator in
  `regulator_response`
- what it says of quantities that other tests measure, too: `contraction_offers`
- by paper 1: `contraction_paper1`, made of `contraction_paper1_steps` and `contraction_known_force`; model against
  test in `contraction_paper1_view`
"""
