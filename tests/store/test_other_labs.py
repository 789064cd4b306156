"""Recordings as other labs make them, by a simulator of this file: what they give is the truth, or withheld.

The muscle pulls with F = 1.9 N/kPa P - 60 N - K x - B x' - 8 N sign x', K = 4 N/mm + 0.012 N/(mm kPa) P, B = 2.2 (1.6
relaxing) N s/mm. It hangs from a cell, and what hangs from it may be borne by a support at x = 0.
"""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from pmabench.cli.main import main
from pmabench.store.reader import open_run

F_C, G = 8.0, 9.81


def force(P, x):
    """Static force without friction [N] at P [kPa] and x [mm]."""
    return 1.9 * P - 60.0 - (4.0 + 0.012 * P) * x


def hung(P, mass, dt, sub=4):
    """Contraction [mm] and the cell [N] under a weight [kg] that rests at x = 0, driven by P [kPa]."""
    weight, inertia, h = mass * G, mass / 1000.0, dt / sub
    x = v = 0.0
    at, cell = np.empty(len(P)), np.empty(len(P))
    for i, p in enumerate(np.interp(np.arange(len(P) * sub) / sub, np.arange(len(P)), P)):
        drive = force(p, x) - weight
        way = np.sign(v) or np.sign(drive)
        if v == 0 and abs(drive) <= F_C:
            after = 0.0
        else:
            after = (v + h / inertia * (drive - F_C * way)) / (1 + h / inertia * (2.2 if way > 0 else 1.6))
            after = 0.0 if v != 0 and np.sign(after) != np.sign(v) else after
        pull, x, v = weight + inertia * (after - v) / h, x + h * after, after
        if x <= 0:
            x, v, pull = 0.0, 0.0, min(max(force(p, 0.0), 0.0), weight)
        if i % sub == 0:
            at[i // sub], cell[i // sub] = x, pull
    return at, cell


def write(path, head, *columns):
    np.savetxt(path, np.column_stack(columns), fmt="%.4f", delimiter=",", header=head, comments="")


def called(*words, codes=(0, 6)):
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code in codes, result.output
    return result.output


def processed(folder, *replacements):
    """Guess, correct the map, import and process the CSV files of a folder: the estimates, and what was printed."""
    files, proposed = sorted(folder.glob("*.csv")), folder / "map.yaml"
    called("import", *files, "--guess", "-o", proposed, "-q")
    text = re.sub(r'force_above: "\?\? ([^"]+)"', r"force_above: \1", proposed.read_text(encoding="utf-8"))
    for old, new in replacements:
        assert old in text, text
        text = text.replace(old, new)
    proposed.write_text(text, encoding="utf-8")
    said = called("import", *files, "--map", proposed, "--out", folder / "runs")
    found = json.loads(called("process", *sorted((folder / "runs").iterdir()), "--out", folder / "a", "--json"))
    return found["analyses"][0]["estimates"], said


def held(rng, x=20.0, rate=100.0):
    """Fill and exhaust of a muscle that is held: time [s], pressure [kPa], force [N]."""
    t = np.arange(0, 40, 1 / rate)
    P = np.interp(t, [0, 3, 17, 22, 36, 40], [0, 0, 500, 500, 0, 0])
    F = np.maximum(force(P, x), 0.0)
    return t, P + rng.normal(0, 0.5, len(t)), F + rng.normal(0, 0.4, len(t))


def test_the_cell_says_the_load_only_where_the_muscle_bears_it(tmp_path):
    """A load on its support shows nothing at the cell: F_ce came out as 0 N where 130 N are true."""
    rng = np.random.default_rng(1)
    for mass in (6.0, 11.0, 16.0, 21.0):
        top = (mass * G + 60.0 + F_C) / 1.9 + 25.0
        t = np.arange(0, top / 2 + 8, 0.05)
        P = np.interp(t, [0, 2, 2 + top / 4, 4 + top / 4, 4 + top / 2], [0, 0, top, top, 0])
        x, F = hung(P, mass, 0.05, sub=20)
        n = len(t)
        write(tmp_path / f"lift_{mass:.0f}kg.csv", "t (s),p_set (kPa),p (kPa),x (mm),F (N)", t, P,
              P + rng.normal(0, 0.1, n), x + rng.normal(0, 0.002, n), F + rng.normal(0, 0.3, n))  # fmt: skip
    found, _ = processed(
        tmp_path, ("kind: recorded-step", "kind: static-load"), ("specimen:", "confirmed: [pressure-unit]\nspecimen:")
    )
    loads = sorted({e["at"]["load"] for e in found if "load" in e["at"]})
    assert loads == pytest.approx([58.86, 107.91, 156.96, 206.01], abs=0.5)
    seen = [e for e in found if (e["symbol"], e["method"]) == ("F_ce", "static-mean") and e["value"] is not None]
    assert seen
    for e in seen:
        assert abs(e["value"] - force(e["at"]["pressure"] / 1e3, 0.0)) < 3.0  # friction by viscosity at 4 kPa/s: 1.3 N


def test_steps_without_a_command_have_no_time_from_it(tmp_path):
    """The time of a command is found in the pressure itself: 14 ms were printed as the dead time of the regulator."""
    rng, dt = np.random.default_rng(2), 0.004
    for mass in (8.0, 20.0):
        t = np.arange(0, 20, dt)
        command = np.interp(t, [0, 2, 2 + 1e-9, 5, 5 + 1e-9, 8, 8 + 1e-9, 11], [0, 0, 350, 350, 250, 250, 0, 0])
        P = np.zeros(len(t))
        for i in range(1, len(t)):
            P[i] = P[i - 1] + (command[max(0, i - 9)] - P[i - 1]) * (1 - np.exp(-dt / 0.09))
        x, F = hung(P, mass, dt)
        n = len(t)
        write(tmp_path / f"{mass:.0f}kg.csv", "t (s),p (kPa),x (mm),F (N)", t, P + rng.normal(0, 0.4, n),
              x + rng.normal(0, 0.003, n), F + rng.normal(0, 0.3, n))  # fmt: skip
    smallest = next(
        word
        for word in called("import", *sorted(tmp_path.glob("*.csv")), "--guess", "-v").split("\n")
        if "by: step" in word
    )
    found, _ = processed(
        tmp_path, ("kind: recorded-step", "kind: contraction-relaxation"), (smallest.strip(), "trials: {by: file}")
    )
    words = {(e["symbol"], e.get("coordinate") or e.get("words") or "", e["method"]) for e in found}
    assert not [one for one in words if "command" in " ".join(one)], words
    runs = [open_run(run) for run in sorted((tmp_path / "runs").iterdir())]
    loads = sorted(trial.point["load"] for run in runs for trial in run.trials)
    assert loads == pytest.approx([8 * G, 20 * G], abs=0.5)  # and not what the cell shows in the 9 s at rest


def test_columns_that_are_exchanged_throughout_withhold_the_slope(tmp_path):
    t, P, F = held(np.random.default_rng(3))
    write(tmp_path / "iso_20mm.csv", "t (s),F (N),P (kPa)", t, P, F)
    found, said = processed(tmp_path, ('"?? 20 mm"', "20 mm"))
    assert all(e["value"] is None for e in found if e["symbol"] in ("m", "c"))
    assert "look exchanged" in said


@pytest.mark.parametrize("x", [0.0, 20.0])
def test_columns_as_they_are_named_do_not(tmp_path, x):
    t, P, F = held(np.random.default_rng(4), x)
    write(tmp_path / "iso_20mm.csv", "t (s),F (N),P (kPa)", t, F, P)
    found, said = processed(tmp_path, ('"?? 20 mm"', "20 mm"))
    (m,) = [e for e in found if (e["symbol"], e["method"]) == ("m", "isometric-line")]
    assert m["value"] == pytest.approx(1e-3 * (1.9 - 0.012 * x), rel=0.003)
    assert "fault" not in said
    assert "doubt" not in said


def test_a_late_force_is_judged_by_the_slope_where_the_muscle_pulls(tmp_path):
    """Over all samples a second moves the slope by 0.98 %, where the muscle pulls by 3 %: that is what is withheld."""
    t, P, F = held(np.random.default_rng(5), 5.0)
    write(tmp_path / "iso_5mm.csv", "t (s),F (N),P (kPa)", t, np.concatenate([np.full(100, F[0]), F[:-100]]), P)
    found, said = processed(tmp_path, ('"?? 5 mm"', "5 mm"))
    assert all(e["value"] is None for e in found if e["symbol"] == "m")
    without = float(re.search(r"([\d.]+) N/kPa without the lag", said)[1])
    assert without == pytest.approx(1.84, rel=0.01)


def sines(folder, rng, head="t (s),x (mm),F (N)"):
    """A driven sine about 15 mm at each of two pressures, which only the names of the files give."""
    for P in (2.0, 4.0):
        t = np.arange(0, 20, 0.005)
        x, v = 15 + 8 * np.sin(np.pi * t), 8 * np.pi * np.cos(np.pi * t)
        F = force(100 * P, x) - 1.9 * v - F_C * np.sign(v)
        write(folder / f"muscle {P:g} bar.csv", head, t, x + rng.normal(0, 0.003, len(t)),
              F + rng.normal(0, 0.3, len(t)))  # fmt: skip


def test_a_pressure_that_was_not_recorded_is_that_of_the_name(tmp_path):
    sines(tmp_path, np.random.default_rng(6))
    found, said = processed(
        tmp_path, ('"?? 0 mm"', "0 mm"), ("unit: kPa", "unit: kPa\n    expanded_uncertainty: 3 kPa")
    )
    for e in found:
        P = e["at"].get("pressure", 0.0) / 1e3
        if (e["symbol"], e["method"]) == ("K", "sine-harmonic") and "frequency" not in e["at"]:
            assert e["ci95"][0] < 1e3 * (4.0 + 0.012 * P) < e["ci95"][1]
        if e["symbol"] == "F":
            low, high = e["ci95"]
            assert low < force(P, 15.0) < high
            assert high - low > 2 * 3 * 1.7  # 3 kPa are 1.72 N/kPa at 15 mm
    assert {e["at"]["pressure"] for e in found if e["symbol"] == "K"} == {2e5, 4e5}
    assert "doubt" not in said


def test_a_pressure_that_was_not_recorded_is_asked_for_and_its_error_is_a_doubt(tmp_path):
    sines(tmp_path, np.random.default_rng(7))
    for path in list(tmp_path.glob("*.csv")):
        path.rename(path.with_name(path.name.replace(" bar", "00")))
    files = sorted(tmp_path.glob("*.csv"))
    called("import", files[0], "--guess", "-o", tmp_path / "map.yaml", "-q")
    text = (tmp_path / "map.yaml").read_text(encoding="utf-8")
    assert "at which pressure was each file recorded?" in text
    answer = ["--set", "trials.point.pressure=2 bar", "--set", "columns.x (mm).contraction.zero=0 mm"]
    said = called("import", files[0], "--map", tmp_path / "map.yaml", "--out", tmp_path / "runs", *answer)
    assert "doubt: pressure was not recorded: 200 kPa throughout" in said
    (run,) = (tmp_path / "runs").iterdir()
    assert set(open_run(run).trials[0].channels["pressure"]) == {2e5}
    (tmp_path / "none.yaml").write_text(text.replace(', point: {pressure: "??"}', "").replace('"?? 0 mm"', "0 mm"))
    said = called("import", files[0], "--map", tmp_path / "none.yaml", "--out", tmp_path / "no", codes=(3,))
    assert "say trials: {point: {pressure: ...}}" in said
    answered = re.sub(r'"\?\? ?([^"]*)"', lambda asked: asked[1] or "2 bar", text)
    (tmp_path / "none.yaml").write_text(re.sub(r'  "@pressure":\n.*\n.*\n', "", answered))
    said = called("import", files[0], "--map", tmp_path / "none.yaml", "--out", tmp_path / "no", codes=(3,))
    assert '"@pressure": {is: pressure, unit: kPa}' in said.replace("\n", " ")


def test_names_with_blanks_or_that_begin_with_a_number_are_read(tmp_path):
    rng = np.random.default_rng(8)
    for x in (0.0, 12.0):
        t, P, F = held(rng, x)
        write(tmp_path / f"{x + 3:.0f} kg iso {x:.0f} mm.csv", "t (s),F (N),P (kPa)", t, F, P)
    text = called("import", *sorted(tmp_path.glob("*.csv")), "--guess", "-v")
    assert '"{mass} kg iso {contraction} mm"' in text
    assert "at which contraction" not in text


def crosshead(path, rng):
    """Ramps at 3 bar on a machine whose crosshead falls by what the muscle shortens, and which reads pulling as negative."""
    t = np.arange(0, 80, 0.02)
    x = 20.0 * (1 - np.abs(1 - (t / 10.0) % 2))
    F = force(300.0, x) - F_C * np.sign(np.gradient(x, t))
    write(path, "Time (s),Crosshead (mm),Load (N)", t, 812.3 - x + rng.normal(0, 0.003, len(t)),
          rng.normal(0, 0.3, len(t)) - F)  # fmt: skip


@pytest.mark.parametrize("name", ["3 bar", "1 bar"])
def test_a_machine_that_reads_pulling_as_negative_is_turned_round_by_a_line(tmp_path, name):
    """The length was taken the other way round, and F_ce came out as -510 N; 1 bar was asked whether it is absolute."""
    crosshead(tmp_path / f"{name}.csv", np.random.default_rng(9))
    unit = "is: force\n    unit: N\n"
    line = (unit, f"{unit}    line: {{slope: -1 N/N, offset: 0 N}}\n")
    found, _ = processed(tmp_path, line, ('"?? 812.1 mm"', "812.3 mm"))
    for symbol, truth in (("F_ce", 510.0), ("K", 7600.0)):
        (e,) = [e for e in found if e["symbol"] == symbol and e["method"] == "mean-curve"]
        assert e["value"] == pytest.approx(truth, rel=0.005)


def test_a_pull_that_is_negative_throughout_withholds_what_rests_on_it(tmp_path):
    crosshead(tmp_path / "3 bar.csv", np.random.default_rng(10))
    found, said = processed(tmp_path, ('"?? 812.1 mm"', "812.3 mm"))
    assert all(e["value"] is None for e in found if e["symbol"] in ("F_ce", "K", "F"))
    assert "pulling is positive" in said


def test_files_that_are_held_at_different_contractions_are_each_at_their_own(tmp_path):
    """m = 0.65 N/kPa - 0.012 N/(kPa mm) x, where the first file alone would say x = 4 mm of all."""
    rng = np.random.default_rng(5)
    for x in (4.0, 8.0, 12.0):
        t, P, F = held(rng, x)
        F = np.maximum((0.65 - 0.012 * x) * P - 2 * x, 0) + 0 * F + rng.normal(0, 0.3, len(t))
        write(
            tmp_path / f"{'abc'[int(x / 4) - 1]}.csv",
            "t [s],P [kPa],contraction [mm],F [N]",
            t,
            P,
            x + rng.normal(0, 0.003, len(t)),
            F,
        )
    found, _ = processed(tmp_path)
    lines = {e["at"]["contraction"]: e["value"] for e in found if e["symbol"] == "m"}
    assert lines == pytest.approx({x / 1e3: (0.65 - 0.012 * x) / 1e3 for x in (4.0, 8.0, 12.0)}, rel=2e-3)


@pytest.mark.parametrize(
    ("name", "g_in_one", "kept"),
    [("Massenstrom [g/min]", 1.0, ()), ("Durchfluss [Nl/min]", 1.29287, (": ignore", ": {is: flow, unit: Nl/min, line: "
      "{slope: 0.0215478 g/s/Nl/min, offset: 0 g/s}}"))],
)  # fmt: skip
def test_the_flow_into_a_muscle_that_is_held_gives_its_volume(tmp_path, name, g_in_one, kept):
    """m' = (V + hose) P'/(r T) of air that keeps the temperature of the room; the zero of the meter is off."""
    rng, volumes = np.random.default_rng(7), {0.0: 60e-6, 10.0: 100e-6}
    for x, V in volumes.items():
        t = np.arange(0, 62, 0.04)
        P = np.interp(t, [0, 6, 26, 34, 54, 62], [50, 50, 450, 450, 50, 50])
        flow = 60e3 * (V + 12e-6) * 1e3 * np.gradient(P, t) / (287.05 * 293.15) + 0.012 + rng.normal(0, 2e-3, len(t))
        F = np.maximum((1 - x / 60) * P - 4 * x, 0) + rng.normal(0, 0.3, len(t))
        write(tmp_path / f"x{x:02.0f}.csv", f"Zeit [s],Druck [kPa],Kontraktion [mm],Kraft [N],{name}", t,
              P + rng.normal(0, 0.1, len(t)), x + rng.normal(0, 0.003, len(t)), F, flow / g_in_one)  # fmt: skip
    settings = "settings: {flow: {dead: 12e-6, dead_half: 0.1e-6}}\n"
    kind = ("kind: isometric ", f"{settings}kind: isometric-pressurisation ")
    found, _ = processed(tmp_path, kind, *([kept] if kept else []))
    V = {1e3 * e["at"]["contraction"]: e["ci95"] for e in found if e["symbol"] == "V"}
    assert V.keys() == volumes.keys()
    for x, (low, high) in V.items():
        assert low < volumes[x] < high < 1.05 * low
