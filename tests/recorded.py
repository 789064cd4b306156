"""Where recorded data of other labs lies, if it lies anywhere: it has no licence and is not part of the project."""

import os
from pathlib import Path

import pytest


def recorded_data() -> Path:
    """The folder `recorded` below PMABENCH_RECORDED_DATA; skips the test where there is none."""
    folder = Path(os.environ.get("PMABENCH_RECORDED_DATA", "")) / "recorded"
    if not os.environ.get("PMABENCH_RECORDED_DATA") or not folder.is_dir():
        pytest.skip("not run: recorded data (set PMABENCH_RECORDED_DATA)")
    return folder
