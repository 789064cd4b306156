"""What to test: protocol files, sweeps, and their compilation to a plan of plain data."""
