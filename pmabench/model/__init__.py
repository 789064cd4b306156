"""Muscle models, regulator, plant and loops as pure functions of arrays and parameters; SI throughout."""
