"""Errors, clocks, quantities and calibration arithmetic; standard library only."""
