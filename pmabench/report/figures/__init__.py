"""Figures with their tables and alternative text.

`figures` says which ones an analysis has, as its kind of test draws them; `coefficient_figures` (over an operating
point), `energy_figures` (work of loops), `repeat_figures`; `characteristic_figures` brings tests together; `overlays`
are published points.
"""
