"""Benches, specimens and calibrations: the files people write, and the plain records that drivers get."""
