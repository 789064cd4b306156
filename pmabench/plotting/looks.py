"""Colours of figures and shapes of their marks."""

INK, QUIET, FAINT = "#16202a", "#52606d", "#a3b1be"
"""Colours of text, of secondary text, and of measured data under a model's line."""
GRID, UNTESTED = "#e8edf2", "#eef1f5"
BLUE, BROWN, GREEN, FAULT = "#0b5394", "#8a4b00", "#0a6c51", "#b3261e"
DARK, TEAL, BRIGHT = "#271102", "#28a0bd", "#0b35da"
PALETTE = (BLUE, BROWN, GREEN, DARK, TEAL, BRIGHT)
"""Colours of series: any two are 30 Lab units apart, also for red-green blindness, with contrast 3 : 1 to paper."""
MARKS, CROSSES = ("o", "s", "^", "D", "v", "<"), ("x", "+", "*")
"""Shapes of own values, and of published ones."""
SHAPES = {
    "s": (((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)),),
    "^": (((0.0, -1.2), (1.15, 0.9), (-1.15, 0.9)),),
    "v": (((0.0, 1.2), (1.15, -0.9), (-1.15, -0.9)),),
    "<": (((-1.2, 0.0), (0.9, -1.15), (0.9, 1.15)),),
    "D": (((0.0, -1.25), (1.25, 0.0), (0.0, 1.25), (-1.25, 0.0)),),
    "x": (((-1.1, -1.1), (1.1, 1.1)), ((-1.1, 1.1), (1.1, -1.1))),
    "+": (((-1.3, 0.0), (1.3, 0.0)), ((0.0, -1.3), (0.0, 1.3))),
    "*": (((-1.2, 0.0), (1.2, 0.0)), ((-0.6, -1.0), (0.6, 1.0)), ((-0.6, 1.0), (0.6, -1.0))),
}
"""Outlines of marks, in radii; besides there are `o`, a dot, and `.`, a small dot for many samples."""
