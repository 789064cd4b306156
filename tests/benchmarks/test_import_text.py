"""Import of a large text file beside the bare reading of it with Arrow in one thread; `make bench`.

1 GB of ten columns (`IMPORT_MB` sets another size); 8 MB in the ordinary suite, where nothing is asserted of time.
Processor time is compared, that of the process which reads the text with it, for the machine does other things too.
"""

import os
import shutil
import time

import pytest
from pyarrow import csv

from tests.store import long_text
from tests.store.test_import_long import MEMORY, imported

SIZE = float(os.environ.get("IMPORT_MB", "1000")) * 1e6
SMALL = 8e6
TIMES = 4.0


def bare(path):
    begin = time.process_time()
    rows = csv.read_csv(path, read_options=csv.ReadOptions(use_threads=False)).num_rows
    return rows, time.process_time() - begin


@pytest.mark.timeout(3600)
def test_an_import_costs_four_times_the_reading_and_stays_small(tmp_path, benchmark):
    size = SMALL if benchmark.disabled else SIZE
    path = tmp_path / "log.csv"
    rows = long_text.write(path, size)
    long_text.write_map(path.with_suffix(".yaml"))
    read, alone = bare(path)
    found = imported(path, tmp_path / "out")
    alone = (alone + bare(path)[1]) / 2
    benchmark.pedantic(lambda: None, rounds=1)
    print(
        f"\n{path.stat().st_size / 1e6:.0f} MB, {rows:,} rows: import {found['cpu']:.1f} s of processor time, Arrow alone"
        f" {alone:.1f} s: {found['cpu'] / alone:.2f} times, at most {TIMES:g}; memory {found['memory'] / 1e6:.0f} MB, and"
        f" {found['of_child'] / 1e6:.0f} MB in the reader, at most {MEMORY / 1e6:.0f}"
    )
    benchmark.extra_info.update(times=found["cpu"] / alone, memory=found["memory"])
    assert read == found["rows"] == rows
    assert found["trials"] == rows // long_text.PER_CYCLE
    shutil.rmtree(tmp_path / "out")
    if not benchmark.disabled:
        assert found["cpu"] < TIMES * alone
        assert found["memory"] < MEMORY
