"""A command keeps freed memory for its next arrays: a new page from the system costs more than what is done with it."""

import subprocess
import sys

import pytest

FAULTS = """
import resource, sys
import numpy as np
from pmabench.base.system import keep_freed_memory

if sys.argv[1] == "kept":
    keep_freed_memory()
for _ in range(10):
    arrays = [np.ones(1_000_000) for _ in range(8)]
    del arrays
    if _ == 1:
        begun = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - begun)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="mallopt is of the C library of Linux")
def test_arrays_take_the_memory_that_others_gave_back():
    kept, usual = (
        int(subprocess.run([sys.executable, "-c", FAULTS, how], capture_output=True, text=True, check=True).stdout)
        for how in ("kept", "usual")
    )
    assert kept < 0.2 * usual
