"""The conformance suite; with the example driver in reach, also in a process that only loads a mutant of it."""

import sys
from pathlib import Path

EXAMPLE_FOLDER = Path(__file__).resolve().parents[2] / "docs" / "driver-example"
sys.path.append(str(EXAMPLE_FOLDER))
