"""Figures with their tables and alternative text.

`figures` says which ones an analysis has, as its kind of test draws them; `coefficient_figures`: over an operating
point; `overlays` are published points.
"""
