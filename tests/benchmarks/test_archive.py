"""An archive of runs beside a bare loop that reads the same Parquet files and makes the same fits; `make bench`.

2,000 runs of 5,000 samples and 6 channels (`ARCHIVE_RUNS` sets another number, for instance 10000); four in the ordinary
suite, where nothing is asserted of time. Processor time is compared, for the machine does other things too. Two
processes are held against one by the processor time that comes one after the other, all of this process and half that
of the workers, and by the wall clock only where the machine is idle.
"""

import os
import resource
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from pmabench.analysis.many import Processes
from pmabench.kinds.recorded_step.motion import fit_motion, from_rest
from pmabench.kinds.recorded_step.reduction import possible_motions
from pmabench.kinds.recorded_step.step import SHIFTS
from pmabench.report.many import process_many, write_table
from pmabench.store.catalogue import tasks_below
from tests.benchmarks.archive import AT, LATE, SCALES, write_run

RUNS = int(os.environ.get("ARCHIVE_RUNS", "2000"))
FEW = 4
OVERHEAD, TWO, AGAIN = 1.3, 1.7, 20.0
GROWTH = 20e3
"""Bytes of memory that each further run may cost: what came out of it is kept until the table is written."""
IDLE = 0.5
"""Load of the machine up to which two processes are judged."""


def bare(folder):
    """Read and fit, and nothing else."""
    table = pq.ParquetFile(folder / "streams" / "file.parquet").read(use_threads=False)
    t = table.column("time_ns").to_numpy() / 1e9 - AT
    P, x = (table.column(name).to_numpy() * SCALES[name][1].slope for name in ("pressure", "displacement"))
    near = (t >= -0.5) & (t <= 0.8)
    driven = t[near], from_rest(P[near], float(np.median(P[near & (t < 0)]))), x[near]
    motions = [fit_motion(*driven, float(late)) for late in np.linspace(*LATE, SHIFTS)]
    return possible_motions(driven, min(motions, key=lambda motion: motion.rms))


def process(runs, out, pool=None, reported=None):
    many = process_many(tasks_below([runs]), out, pool, reported)
    write_table(many)
    return many


def timed(work):
    """What comes out, processor time and wall clock [s]."""
    began, wall = time.process_time(), time.perf_counter()
    result = work()
    return result, time.process_time() - began, time.perf_counter() - wall


def memory():
    """Resident memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@pytest.mark.timeout(7200)
def test_an_archive_costs_little_more_than_reading_and_fitting(tmp_path, benchmark):
    count, load = (FEW if benchmark.disabled else RUNS), os.getloadavg()[0]
    runs, sizes = tmp_path / "runs", {}
    folders = [write_run(runs, number) for number in range(count)]
    process(runs / folders[0].name, tmp_path / "warm")

    def reported(done, _total, _unchanged):
        if done in (count // 4, count):
            sizes[done] = memory()

    loop, loop_cpu, loop_wall = timed(lambda: [bare(folder) for folder in folders])
    many, cpu, wall = timed(lambda: process(runs, tmp_path / "one", None, reported))
    again, again_cpu, again_wall = timed(lambda: process(runs, tmp_path / "one"))
    pool, before = None if benchmark.disabled else Processes(2), os.times()
    try:
        _, here, two_wall = timed(lambda: process(runs, tmp_path / "two", pool))
    finally:
        if pool is not None:
            pool.close()
    after = os.times()
    there = after.children_user + after.children_system - before.children_user - before.children_system
    path = here + there / 2
    benchmark.pedantic(lambda: None, rounds=1)
    growth = (sizes[count] - sizes[count // 4]) / (count - count // 4)
    print(
        f"\n{count} runs, load {load:.1f} at the start: read and fit alone {1e3 * loop_cpu / count:.1f} ms of processor"
        f" time a run ({loop_wall:.1f} s), process {1e3 * cpu / count:.1f} ms ({wall:.1f} s): {cpu / loop_cpu:.2f} times,"
        f" at most {OVERHEAD}\n  again, nothing changed: {again_wall:.2f} s, {cpu / again_cpu:.0f} times faster by"
        f" processor time, at least {AGAIN:.0f}\n  two processes: {two_wall:.1f} s, {wall / two_wall:.2f} times one, at"
        f" least {TWO} on an idle machine; {here:.1f} s of processor time here and {there:.1f} s in both, their start"
        f" with it: on two free cores {cpu / path:.2f} times\n  memory: {growth / 1e3:.1f} kB more for each run, at most {GROWTH / 1e3:.0f}"
    )
    benchmark.extra_info.update(overhead=cpu / loop_cpu, again=cpu / again_cpu, two=wall / two_wall, growth=growth)
    assert many.exit_code == 0
    fitted = {e["method"]: e["value"] for e in next(many.results())["estimates"] if e["symbol"] == "K"}
    least, most = (
        extreme(7.85 * (one.K + way * one.half_K) for one in loop[0]) for extreme, way in ((min, -1), (max, 1))
    )
    assert fitted["ringing-of-known-mass"] == pytest.approx((least + most) / 2, rel=1e-3)
    assert again.count("unchanged") == count
    one, two = (sorted(p.read_bytes() for p in (tmp_path / name).glob("all-runs.*")) for name in ("one", "two"))
    assert one == two
    if not benchmark.disabled:
        assert cpu < OVERHEAD * loop_cpu
        assert again_cpu * AGAIN < cpu
        assert growth < GROWTH
        assert path * TWO < cpu
        assert load > IDLE or two_wall * TWO < wall
