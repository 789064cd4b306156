"""Makes `fixtures/old-runs/foreign`: one simulated test in the formats of LabVIEW, TDMS and MATLAB, with known faults.

All numbers are simulated here. The writers are npTDMS, scipy and h5py; LVM is written by hand after its specification.
Run as `python -m tests.fixtures_foreign` to make them again. `TRUTH` is what stands in every one of them.
"""

from __future__ import annotations

import sys
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).parent.parent / "fixtures" / "old-runs" / "foreign"
STARTED = datetime(2026, 1, 7, 9, 30, 15, 250000)  # by a local clock, as LabVIEW writes it
RATE = 100.0
N = 600
CUT = (50, 51)
"""Samples of pressure that read 0 mA."""
SPIKE = 300
"""A lone sample of force."""
STUCK = (400, 480)
"""Samples in which displacement does not change."""


def truth() -> dict[str, np.ndarray]:
    """Readings by name, shape (600,): t [s], P [mA], F [N], x [mm], command [bar]; two steps of pressure."""
    rng = np.random.default_rng(7)
    t = np.arange(N) / RATE
    command = np.where((t >= 1.5) & (t < 3.5), 4.0, 2.0)
    P = np.full(N, 2.0)
    for k in range(1, N):
        P[k] = P[k - 1] + (command[k - 1] - P[k - 1]) * (1 - np.exp(-0.01 / 0.08))
    current = np.round(4.0 + P * 2.0 + rng.normal(0, 0.004, N), 3)
    current[list(CUT)] = 0.0
    force = np.round(120.0 + 60.0 * P + rng.normal(0, 0.4, N), 2)
    force[SPIKE] += 80.0
    displacement = np.round(6.0 * P + rng.normal(0, 0.02, N), 3)
    displacement[slice(*STUCK)] = displacement[STUCK[0]]
    return {"t": t, "P": current, "F": force, "x": displacement, "command": command}


NAMES = {"P": "Pressure sensor", "F": "Load cell", "x": "Displacement", "command": "Set pressure"}
UNITS = {"P": "mA", "F": "N", "x": "mm", "command": "bar"}


def lvm(columns: str, decimal: str = ".", segments: int = 1) -> str:
    """An LVM file; `columns`: No, One or Multi, as X_Columns says."""
    data, keys = truth(), list(NAMES)

    def mark(text: str) -> str:
        return text.replace(".", decimal)

    def row(values: list[str]) -> str:
        return "\t".join(values)

    def each(key: str, value: str) -> str:
        gap = ["", value] if columns == "Multi" else [value]
        return row([key, *([value] + gap * (len(keys) - 1))])

    date, time = STARTED.strftime("%Y/%m/%d"), mark(STARTED.strftime("%H:%M:%S.%f"))
    lines = [
        "LabVIEW Measurement\t",
        *("Writer_Version\t2", "Reader_Version\t2", "Separator\tTab", f"Decimal_Separator\t{decimal}"),
        *(f"Multi_Headings\t{'Yes' if segments > 1 or columns == 'No' else 'No'}", f"X_Columns\t{columns}"),
        *("Time_Pref\tAbsolute", "Operator\tnobody", f"Date\t{date}", f"Time\t{time}", "***End_of_Header***\t", "\t"),
    ]
    size = N // segments
    for part in range(segments):
        clock = STARTED + timedelta(seconds=part * size / RATE)
        lines += [
            row(["Channels", str(len(keys))]),
            each("Samples", str(size)),
            each("Date", clock.strftime("%Y/%m/%d")),
            each("Time", mark(clock.strftime("%H:%M:%S.%f"))),
            row(["Y_Unit_Label", *(("\t\t" if columns == "Multi" else "\t").join(UNITS[k] for k in keys)).split("\t")]),
            each("X_Dimension", "Time"),
            each("X0", mark("0.0000000000000000E+0")),
            each("Delta_X", mark("0.010000")),
            "***End_of_Header***\t",
        ]
        titles = [NAMES[k] for k in keys]
        pairs = [text for title in titles for text in ("X_Value", title)]
        lines.append(row([*(pairs if columns == "Multi" else ["X_Value", *titles]), "Comment"]))
        for k in range(part * size, (part + 1) * size):
            x = mark(f"{data['t'][k] - part * size / RATE:.6f}")
            values = [mark(f"{data[key][k]:.6f}") for key in keys]
            if columns == "Multi":
                lines.append(row([text for value in values for text in (x, value)]))
            else:
                lines.append(row(["" if columns == "No" else x, *values]))
        lines.append("")
    return "\r\n".join(lines) + "\r\n"


def write_tdms(path: Path) -> None:
    """Two groups: the channels, and the log of something else."""
    from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

    data = truth()
    timing: dict[str, Any] = {"wf_increment": 1 / RATE, "wf_start_offset": 0.0, "wf_start_time": STARTED}
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                RootObject({"name": "simulated by pmabench"}),
                GroupObject("bench"),
                *(ChannelObject("bench", NAMES[k], data[k], {**timing, "unit_string": UNITS[k]}) for k in NAMES),
                ChannelObject("room", "temperature", np.full(20, 21.5), {"unit_string": "degC"}),
            ]
        )


def mat_content() -> dict[str, Any]:
    """A struct as a script of a lab would save it: column vectors, a matrix and a text."""
    data = truth()
    return {
        "log": {
            "time_s": data["t"][:, None],
            "pressure_mA": data["P"][:, None],
            "FX": np.column_stack([data["F"], data["x"]]),
            "cmd_bar": data["command"][:, None],
        },
        "who": "nobody",
    }


def write_mat73(path: Path) -> None:
    """As MATLAB writes 7.3: 512 bytes of its header before an HDF5 file, arrays transposed, classes as attributes."""
    import h5py

    reported = mat_content()
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log", track_order=False)
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, value in reported["log"].items():
            dataset = group.create_dataset(name, data=value.T, track_times=False)
            dataset.attrs["MATLAB_class"] = np.bytes_("double")
        text = file.create_dataset("who", data=np.array([[ord(c)] for c in reported["who"]], dtype=np.uint16))
        text.attrs["MATLAB_class"] = np.bytes_("char")
    header = b"MATLAB 7.3 MAT-file, made by pmabench, HDF5 schema 1.00 .".ljust(116) + b"\0" * 8 + b"\x00\x02IM"
    with path.open("r+b") as out:
        out.write(header)


def write_mat5(path: Path) -> None:
    """As scipy writes version 5, compressed; the time in its header is taken out."""
    from scipy.io import savemat

    savemat(path, mat_content(), do_compression=True)
    content = path.read_bytes()
    path.write_bytes(b"MATLAB 5.0 MAT-file, made by pmabench".ljust(116) + content[116:])


def make(folder: Path) -> None:
    """All of them, always the same."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "one.lvm").write_bytes(lvm("One").encode())
    (folder / "comma.lvm").write_bytes(lvm("No", ",").encode())
    (folder / "segments.lvm").write_bytes(lvm("Multi", segments=3).encode())
    write_tdms(folder / "bench.tdms")
    write_mat5(folder / "log5.mat")
    write_mat73(folder / "log73.mat")


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
