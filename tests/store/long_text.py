"""Imports a generated text file in a process of its own and tells how much memory that took; for the tests of size.

`python -m tests.store.long_text FILE OUT`: prints rows, trials, seconds of CPU, and the largest resident memory of this
process and of the one that reads the text [bytes].
"""

import json
import os
import re
import resource
import sys
import time
from pathlib import Path

import numpy as np

from pmabench.store.importers import apart
from tests.importing import import_files

NAMES = ("t_s", "pressure_kPa", "force_N", "disp_mm", "set_kPa", "supply_kPa", "temp", "flow", "volt", "aux")
ROLES = ("time", "pressure", "force", "displacement", "pressure_command", "supply")
UNITS = ("s", "kPa", "N", "mm", "kPa", "kPa")
PERIOD, PER_CYCLE = 1e-3, 20_000
"""Distance of the rows [s] and rows of one rise and fall of the pressure."""
BLOCK = 100_000


def write(path: Path, size: float) -> int:
    """Ten columns of `size` bytes and a few more; the number of rows."""
    rng = np.random.default_rng(7)
    rows = 0
    with path.open("w") as file:
        file.write(",".join(NAMES) + "\n")
        while file.tell() < size:
            k = np.arange(rows, rows + BLOCK)
            P = 250 - 200 * np.cos(2 * np.pi * k / PER_CYCLE)
            noise = rng.standard_normal((BLOCK, 7))
            columns = [
                k * PERIOD,
                P + 0.3 * noise[:, 0],
                1.3 * P + 0.2 * noise[:, 1],
                20 + 0.05 * P,
                P,
                700 + noise[:, 2],
            ]
            np.savetxt(file, np.column_stack([*columns, noise[:, 3:]]), fmt=["%.4f"] + ["%.5f"] * 9, delimiter=",")
            rows += BLOCK
    return rows


def write_map(path: Path) -> None:
    columns = "".join(f"  {n}: {{is: {r}, unit: {u}}}\n" for n, r, u in zip(NAMES, ROLES, UNITS, strict=False))
    path.write_text(
        "schema: pmabench.map/1\nname: generated\nsource: the project\nkind: isometric\n"
        f"file: {{delimiter: comma, header: first line}}\ncolumns:\n{columns}"
        + "".join(f"  {name}: ignore\n" for name in NAMES[len(ROLES) :])
        + "sampling: {rate: [700 Hz, 1400 Hz], gap: 10 ms}\ntrials: {by: ramp, smallest: 200 kPa}\nspecimen: {type: X}\n"
    )


def _largest(pid: int) -> int:
    """The largest resident memory of a process [bytes]; `getrusage` would count that of the process it came from."""
    text = Path(f"/proc/{pid}/status").read_text()
    return 1024 * int(re.search(r"VmHWM:\s+(\d+)", text)[1])


def main() -> None:
    path, out = Path(sys.argv[1]), Path(sys.argv[2])
    begin, wall = time.process_time(), time.perf_counter()
    (run,) = import_files([path], path.with_suffix(".yaml"), out)
    child = apart._children["text"].process.pid
    memory, of_child = _largest(os.getpid()), _largest(child)
    wall = time.perf_counter() - wall
    apart.close_readers()
    reader = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = time.process_time() - begin + reader.ru_utime + reader.ru_stime
    reported = {
        "rows": run.rows,
        "trials": run.trials,
        "cpu": cpu,
        "wall": wall,
        "memory": memory,
        "of_child": of_child,
    }
    print(json.dumps({**reported, "path": str(run.path)}))


if __name__ == "__main__":
    main()
