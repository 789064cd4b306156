"""Units of a map that are wrong by what another column of the file, or the size of the muscle, says."""

import numpy as np
import pytest

from pmabench.store.importers.prepare import prepare
from tests.importing import read_map

RATE = 50.0
T = np.arange(1000) / RATE
MAP = """
schema: pmabench.map/1
name: another lab
source: closed form
kind: {kind}
file: {{delimiter: comma, header: first line}}
columns:
  t: {{is: time, unit: s}}
  p: {{is: pressure, unit: {p}}}
  x: {{is: displacement, unit: {x}, contraction: {{reading: rises, zero: 0 {x}}}}}
{more}
  set: {{is: pressure_command, unit: kPa}}
sampling: {{rate: [40 Hz, 60 Hz], gap: 200 ms}}
trials: {trials}
specimen: {{type: M, serial: I, nominal_length: 250 mm, inner_diameter: 20 mm}}
{end}
"""
HELD = """  F: {is: force, unit: N}
  n: {is: trial}
  length: {is: point, of: contraction, unit: mm}"""


def looked(tmp_path, columns, text):
    """Findings by kind, and questions by name, of one file."""
    lines = [
        ",".join(columns),
        *(",".join(f"{value:.7g}" for value in row) for row in zip(*columns.values(), strict=True)),
    ]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    prepared = prepare(tmp_path / "log.csv", read_map(tmp_path / "map.yaml"))
    return {each.kind: each for each in prepared.findings}, {each.what: each for each in prepared.questions}


def held(tmp_path, force=1.0, moved=1.0, length=1.0, confirmed=""):
    """Held at 0, 10 and 20 mm: F = 9 (1 - 3 eps) P A - 30 N, A of a bore of 20 mm; each column times its factor."""
    rng, blocks = np.random.default_rng(0), []
    P = np.interp(T, [2, 10, 12, 20], [0.0, 500e3, 500e3, 0.0])
    for number, x in enumerate((0.0, 10.0, 20.0)):
        F = np.maximum(9 * (1 - 3 * x / 250) * P * np.pi * 0.01**2 - 30.0, 0.0)
        noise = rng.normal(0, [[0.3], [0.005], [0.3]], (3, len(T)))
        blocks.append([T + 25 * number, P / 1e3 + noise[0], (x + noise[1]) * moved, (F + noise[2]) * force, P / 1e3,
                       np.full(len(T), number + 1), np.full(len(T), x * length)])  # fmt: skip
    columns = dict(zip(("t", "p", "x", "F", "set", "n", "length"), np.hstack(blocks), strict=True))
    text = MAP.format(kind="isometric-pressurisation", p="kPa", x="mm", more=HELD, trials="{by: column}", end=confirmed)
    return looked(tmp_path, columns, text)


def waved(tmp_path, unit):
    """A sine of 300 +- 50 kPa, which a regulator follows 0.1 s later, in kPa."""
    w = 2 * np.pi * 0.5
    sent = 300 + 50 * np.sin(w * T)
    P = 300 + 50 * np.sin(w * T - np.arctan(w * 0.1)) / np.hypot(1, w * 0.1)
    noise = np.random.default_rng(0).normal(0, [[0.3], [0.01]], (2, len(T)))
    columns = {"t": T, "p": P + noise[0], "x": 0.3 * (P - 100) + noise[1], "set": sent}
    text = MAP.format(kind="recorded-sine", p=unit, x="mm", more="", trials="{by: sine, smallest: 10 kPa}", end="")
    return looked(tmp_path, columns, text)


def test_a_file_with_its_own_units_has_no_finding(tmp_path):
    assert held(tmp_path) == ({}, {})
    found, asked = waved(tmp_path, "kPa")
    assert "scale" not in found
    assert not asked


def test_kilograms_called_newtons_withhold_at_several_lengths(tmp_path):
    """673 half widths without a word."""
    found, _ = held(tmp_path, force=1 / 9.80665)
    assert found["magnitude"].withholds
    assert "is the force in kg, not N?" in found["magnitude"].text


def test_pounds_called_newtons_are_a_question(tmp_path):
    _, asked = held(tmp_path, force=1 / 4.448)
    assert "is the force in pounds, not N?" in asked["force-unit"].question
    assert held(tmp_path, force=1 / 4.448, confirmed="confirmed: [force-unit]")[1] == {}


@pytest.mark.parametrize(("columns", "asked"), [({"moved": 0.1}, "is x in cm"), ({"length": 0.1}, "is length in cm")])
def test_centimetres_called_mm_next_to_a_column_that_is_right_withhold(tmp_path, columns, asked):
    found, _ = held(tmp_path, **columns)
    assert found["scale"].withholds
    assert f"{asked}, not mm?" in found["scale"].text
    assert not held(tmp_path, **columns, confirmed="confirmed: [scale]")[0]["scale"].withholds


def test_kpa_called_psi_next_to_their_command_withhold(tmp_path):
    """P/P_set was 6.7: 170 half widths."""
    found, _ = waved(tmp_path, "psi")
    assert found["scale"].withholds
    assert "is p in kPa, not psi?" in found["scale"].text
