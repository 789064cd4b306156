"""Parts of reductions: selecting trials, fitting lines, effects of instruments on a result.

- `sound` (what every reduction relies on), `trials` (the course of a reduction, operating points, repeats, reference
  trials, sessions), `samples` of one trial (noise, motion, onset, rest), `gaps` (what missing samples hide)
- `lines` (weighted lines and their intervals, least squares for many values of one parameter), `student` (quantiles,
  means with half widths)
- `isometric_lines` (F over P at a contraction), `ramp_loop` (loops of a driven end, or of a joint; delays at their
  turns), `sine_loop`, `signals` (spikes, smoothing and lag of a sensor; peaks and oscillation; the response to a
  set-point), `simulated` (a model simulated for a trial)
- `joint` (what sweeps and locked torques of a joint share: turns, play, deviation from commands)
- `changes` (of a sensor in the middle of a run, by what repeats itself, and by the command of a drive)
- `regulated` (a pressure at rest that is off its command), `saturated` (a channel that ends at a ceiling)
- `form` (effect of a departure from the assumed form), `calibration` (effect of the channels' uncertainties), `skew`
  (effect of separate clocks)
"""
