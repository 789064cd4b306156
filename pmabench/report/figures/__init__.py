"""Figures with their tables and alternative text.

`figures` says which ones an analysis has. Each kind of test has its `..._figures`, which name and explain, and draw
through `plots` and the `..._plots`; `characteristic_figures` brings tests together. `pictures` and `svg` are what every
figure is; `overlays` are published points.
"""
