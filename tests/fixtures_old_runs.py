"""Makes `fixtures/old-runs`: files of our own with the layouts and the faults of files that real benches wrote.

All numbers are simulated here; none is taken from anybody's recording. Run as `python -m tests.fixtures_old_runs` to
make them again. `TRUTH` says what a reduction has to find in them (SI).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).parent.parent / "fixtures" / "old-runs"
WRONG = (1.6475 * 4.45, -30.882 * 4.45)
RIGHT = (0.1535 * 4.45, -1.963 * 4.45)
PRESSURE = (0.7654, -18.609)

TRUTH: dict[str, Any] = {
    "isometric": {0.0: (0.70e-3, -50.0), 0.004: (0.60e-3, -90.0)},
    "branch": 8.0,
    "mass": 5.0,
    "K": 1500.0,
    "B": 40.0,
    "force_per_pressure": 0.2e-3,
    "late": 0.015,
    "dead": 0.030,
    "sine_gain": 8.0e-8,
    "sine_phase": -0.20,
    "pull": {0.0050: 0.9e-3, 0.0150: 0.8e-3, 0.0300: 0.6e-3},
}


def isometric(contraction: float, test: int, rng: np.random.Generator) -> np.ndarray:
    """Counts of force and pressure, and time [s], of a fill until 27 s and an exhaust after it; shape (n, 3)."""
    t = np.round(np.arange(600) * 0.08, 3)
    slow = {1: 2.0, 2: 2.2, 10: 3.0}[test]
    P = np.where(t < 27.0, 640e3 * (1 - np.exp(-t / slow)), 90e3 + 550e3 * np.exp(-(t - 27.0) / (1.5 * slow)))
    slope, start = TRUTH["isometric"][contraction]
    branch = np.where(t < 27.0, -1.0, 1.0) * TRUTH["branch"] * np.clip(P / 100e3, 0, 1)
    F = np.maximum(slope * (1 + {1: 0.004, 2: -0.004, 10: 0.0}[test]) * P + start + branch, 2.0)
    F = F + rng.normal(0, 1.0, len(t))
    force = np.clip(np.round((F - RIGHT[1]) / RIGHT[0]), 0, 1023)
    pressure = np.round((P / 1e3 - PRESSURE[1]) / PRESSURE[0])
    return np.column_stack([force, pressure, t])


def five_digits(value: float) -> str:
    """As MATLAB writes numbers: five significant digits."""
    return f"{value:.5g}"


def write_isometric(path: Path, samples: np.ndarray, scale: tuple[float, float], phase: bool) -> None:
    """Force made newtons with `scale`, pressure kilopascals; `phase`: with a fourth column."""
    lines = []
    for force, pressure, t in samples:
        fields = [
            five_digits(force * scale[0] + scale[1]),
            five_digits(pressure * PRESSURE[0] + PRESSURE[1]),
            f"{t:.5g}",
        ]
        lines.append(",".join([*fields, *(["1" if t < 27.0 else "2"] if phase else [])]))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def make_isometric(folder: Path, rng: np.random.Generator) -> None:
    """Six files in wrong newtons, two of them rewritten, one of those twice."""
    for name, contraction in (("Unkinked", 0.0), ("Kinked4mm", 0.004)):
        for test in (1, 2, 10):
            samples = isometric(contraction, test, rng)
            stem = f"10mm_13cm_{name}_Test{test}.csv"
            if (name, test) == ("Kinked4mm", 2):
                samples[40] = samples[39]
                samples[300, 0] = 0
            write_isometric(folder / stem, samples, WRONG, phase=(name, test) == ("Unkinked", 1))
            if name == "Kinked4mm" and test in (1, 10):
                again = (RIGHT[0] / WRONG[0], RIGHT[1] - WRONG[1] * RIGHT[0] / WRONG[0])
                twice = (RIGHT[0] * again[0], RIGHT[1] * again[0] + again[1])
                write_isometric(folder / "rewritten" / stem, samples, RIGHT if test == 1 else twice, phase=False)


HEADER = "T_(ms),Sys_Volts_(V),Comp_P_(mA),Piezo_P_(mA),Piezo_out_(mV),V_dist_(mA),LC_(grams)"


def polled(
    t: np.ndarray, command: np.ndarray, P: np.ndarray, x: np.ndarray, F: np.ndarray, rng: np.random.Generator
) -> list[str]:
    """Lines of a log whose pressure is late and whose load cell is slow; command, P [Pa], x [m], F [N] at `t` [s]."""
    late = np.interp(t - TRUTH["late"], t, P)
    pressure = late / 75e3 + 4.0 + rng.normal(0, 0.002, len(t))
    distance = 18.82 - x / 0.1016 * 16.0 + rng.normal(0, 0.003, len(t))
    slow = F[np.searchsorted(t, np.floor(t / 0.09) * 0.09).clip(0, len(t) - 1)]
    rows = []
    for k in range(len(t)):
        rows.append(
            f"{t[k] * 1e3:.3f},{19.48 + 0.004 * (k % 3):.3f},13.{250 + k % 7},{pressure[k]:.3f},"
            f"{round(command[k] / 600e3 * 16000 / 80) * 80 + 4000},{distance[k]:.3f},{round(slow[k] / 9.81e-3)}"
        )
    return rows


def stamps(begin: float, end: float, rng: np.random.Generator) -> np.ndarray:
    """Irregular time stamps of about 100 Hz [s]."""
    return begin + np.cumsum(rng.uniform(0.008, 0.012, int((end - begin) * 100)))


def write_log(path: Path, rows: Sequence[str], notes: str, blank: bool = True, end: str = "\n") -> None:
    """One log with its notes beside it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = "\n".join([HEADER, *([""] if blank else []), *rows]) + end
    path.write_text(text, encoding="utf-8")
    path.with_name(path.name.replace("_data.dat", "_notes.txt")).write_text(notes, encoding="utf-8")


def respond(t: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Contraction [m] of a mass on the muscle M x'' + B x' + K x = f P, from rest at P[0], by small steps."""
    M, K, B, f = TRUTH["mass"], TRUTH["K"], TRUTH["B"], TRUTH["force_per_pressure"]
    fine = np.arange(t[0], t[-1], 1e-4)
    drive = np.interp(fine, t, P)
    x, v = f * P[0] / K, 0.0
    out = np.empty(len(fine))
    for k in range(len(fine)):
        v += 1e-4 * (f * drive[k] - K * x - B * v) / M
        x += 1e-4 * v
        out[k] = x
    return np.interp(t, fine, out)


def make_steps(folder: Path, rng: np.random.Generator) -> None:
    """120 to 360 kPa at 2 s and back at 4 s, with single zeros in the command; a second file without a line end."""
    for number, name in enumerate(("2026-01-05_101500_step_exp", "2026-01-05_102000_step_exp")):
        t = stamps(0.0, 5.6, rng)
        command = np.where((t > 2.0) & (t < 4.0), 360e3, 120e3)
        dense = np.arange(0.0, t[-1] + 0.01, 1e-3)
        late = dense - TRUTH["dead"]
        P = 120e3 + 240e3 * (1 - np.exp(-np.maximum(late - 2.0, 0) / 0.02))
        P -= 240e3 * (1 - np.exp(-np.maximum(late - 4.0, 0) / 0.02))
        x = respond(dense, P)
        command[np.searchsorted(t, 2.0)] = command[np.searchsorted(t, 4.0)] = 0.0
        F = np.full(len(t), 49.05) + rng.normal(0, 0.2, len(t))
        rows = polled(t, command, np.interp(t, dense, P), np.interp(t, dense, x), F, rng)
        notes = (
            "Nickname: step\nUser Notes:\n    made by pmabench, 5 kg hanging\nSequence:\n\t-[0.00, 20]\n\t-[2.00, 60]\n"
        )
        write_log(folder / name / "step_data.dat", rows, notes, blank=number == 0, end="\n" if number == 0 else "")


def make_sines(folder: Path, rng: np.random.Generator) -> None:
    """Three frequencies with a decimal comma in the name; the fastest with a time jump and a gap."""
    for clock, reported in (("103000", "6,28"), ("103100", "12,56"), ("103200", "18,84")):
        omega = float(reported.replace(",", "."))
        t = stamps(0.0, 4.3, rng)
        angle = omega * t
        command = 300e3 * (1 + np.sin(angle))
        P = 290e3 + 250e3 * np.sin(angle - 0.01 * omega)
        x = 0.022 + TRUTH["sine_gain"] * 250e3 * np.sin(angle - 0.01 * omega + TRUTH["sine_phase"])
        F = 4.0 + 0.5 * np.sin(angle)
        rows = polled(t, command, P, x, F, rng)
        if reported == "18,84":
            kept = [row.split(",") for row in rows]
            for row in kept[380:]:
                row[0] = f"{float(row[0]) - 1200:.3f}"
            rows = [",".join(row) for row in (*kept[:200], *kept[215:])]
        name = f"2026-01-05_{clock}_frq_test_rads-{reported}_exp"
        notes = f"Frequency response parameters:\n\t- Frequency: {omega:.3f} rad/s\n"
        write_log(folder / name / f"frq_test_rads-{reported}_data.dat", rows, notes)


def make_pull(folder: Path, rng: np.random.Generator) -> None:
    """Three contractions, pressure rising in steps at each; pauses of 8 s between, cut wires at the start."""
    rows: list[str] = []
    begin = 5.0
    for contraction, slope in TRUTH["pull"].items():
        t = stamps(begin, begin + 2.4, rng)
        command = 120e3 * np.minimum(4, np.floor(1 + (t - begin) / 0.6))
        P = command - 8e3
        F = np.maximum(slope * P - 6000.0 * contraction, 1.0) + rng.normal(0, 0.3, len(t))
        part = polled(t, command, P, np.full(len(t), contraction), F, rng)
        if not rows:
            cut = [row.split(",") for row in part[:12]]
            part[:12] = [",".join([*row[:3], "0.000", *row[4:]]) for row in cut]
        rows += part
        begin = float(t[-1]) + 8.0
    notes = "Nickname: characterization\nSystem Characterization Parameters:\n\t- Step size: 20.00 percent\n"
    write_log(folder / "2026-01-05_104000_characterization_exp" / "characterization_data.dat", rows, notes)


def make(folder: Path) -> None:
    """All of them, always the same."""
    rng = np.random.default_rng(20261121)
    make_isometric(folder / "isometric", rng)
    make_steps(folder / "polled", rng)
    make_sines(folder / "polled", rng)
    make_pull(folder / "polled", rng)


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
