"""Runs and analyses as files of other programs: CSV, Parquet, MATLAB, LaTeX, JSON, python-control, MuJoCo; no estimate.

Units are in the heads of columns, in field metadata (Parquet) or in a struct `units` (MATLAB). Text is inert in each.
The same input gives the same bytes.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pmabench.base.errors import UsageError
from pmabench.notebook import Results, Run, estimates_frame, headed
from pmabench.plotting.svg import symbol_parts
from pmabench.plotting.wording import Frame, clean, point_shown, shown
from pmabench.report.document import tables
from pmabench.report.files.csv_files import csv_text, inert, plain_head, write_tables
from pmabench.report.files.simulator_models import control_model, control_text, mujoco_model, mujoco_text, suits
from pmabench.report.files.surface_model import suits_surface, surface_rows, surface_text
from pmabench.report.words import kind_title
from pmabench.report.writing import write_file, writing
from pmabench.store.analyses.folder import file_names
from pmabench.store.analyses.results import POINT_QUANTITIES, Analysis
from pmabench.store.folder import plain
from pmabench.store.livestream import pa, pq
from pmabench.store.records import RunData

_UNIT = re.compile(r"(.*) \[([^\[\]]*)\]")


def export_run(run: Run, form: str, out: Path) -> list[Path]:
    """Samples and trials of a run: `csv` and `parquet` into the folder `out`, `mat` as the file `out`.

    UsageError for a format of results; RecordError where it cannot be written.
    """
    frames = {name: run.stream(name) for name in run.streams}
    frames["trials"] = run.trials.reset_index()
    with writing(out, "the export"):
        if form == "csv":
            return _run_csv(run, frames, out)
        if form == "parquet":
            return _parquet(frames, out, {"run": run.id, "simulated": str(run.simulated).lower()})
        if form == "mat":
            structs = {name: _struct(frame) for name, frame in zip(_fields(frames), frames.values(), strict=True)}
            return [_mat(structs | {"run": run.id, "simulated": run.simulated}, out)]
    raise UsageError(f"{form} is a format of results: give an analysis folder, or a run to be processed")


def _run_csv(run: Run, frames: dict[str, pd.DataFrame], out: Path) -> list[Path]:
    """One file per stream and one of the trials.

    One of them says in each row of which trial it is, its operating point and whether it is simulated. Where several
    streams were recorded it has the samples of the trials on one time base.
    """
    if len(run.streams) == 1 or not run.data.trials:
        name, frame = run.streams[0], frames[run.streams[0]]
    else:
        numbers = dict.fromkeys(trial.number for trial in run.data.trials)
        name, frame = "samples", pd.concat([run.trial(number) for number in numbers], ignore_index=True)
    return _csv({**frames, name: _with_trials(run, frame)}, out)


def _with_trials(run: Run, frame: pd.DataFrame) -> pd.DataFrame:
    """The samples with the number of their trial, its operating point, and `simulated` where they are.

    Samples between trials have 0, and so have those of a trial that no fit takes: excluded by a note, superseded,
    interrupted, or done again for comparison. Whoever imports the file would take any number for a good trial.
    """
    t = frame["t [s]"].to_numpy()
    number = np.zeros(len(t), dtype=np.int64)
    points = dict.fromkeys(name for trial in run.data.trials for name in trial.point)
    columns = {headed(f"trial {name}", POINT_QUANTITIES.get(name, "")): np.full(len(t), np.nan) for name in points}
    for trial in run.data.trials:
        if len(trial.t) and trial.status == "finished" and not trial.again:
            rows = slice(*np.searchsorted(t, [trial.t[0] - 1e-9, trial.t[-1] + 1e-9]))
            number[rows] = trial.number
            for values, name in zip(columns.values(), points, strict=True):
                values[rows] = trial.point.get(name, np.nan)
    simulated = {"simulated": np.ones(len(t), dtype=np.int64)} if run.simulated else {}
    return frame.assign(trial=number, **columns, **simulated)


def _csv(frames: Mapping[str, pd.DataFrame], out: Path) -> list[Path]:
    writer = import_module("pyarrow.csv")
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / f"{name}.csv" for name in file_names(list(frames))]
    for path, frame in zip(paths, frames.values(), strict=True):
        texts = {c: frame[c].map(inert) for c in frame.columns if not pd.api.types.is_numeric_dtype(frame[c])}
        table = pa.Table.from_pandas(frame.assign(**texts).rename(columns=inert), preserve_index=False)
        writer.write_csv(table, path)
    return paths


def _parquet(frames: Mapping[str, pd.DataFrame], out: Path, about: Mapping[str, str]) -> list[Path]:
    out.mkdir(parents=True, exist_ok=True)
    paths = [out / f"{name}.parquet" for name in file_names(list(frames))]
    for path, frame in zip(paths, frames.values(), strict=True):
        table = pa.Table.from_pandas(frame, preserve_index=False)
        fields = [field.with_metadata({"unit": _split(field.name)[1]}) for field in table.schema]
        table = table.cast(pa.schema(fields, metadata=dict(about)))
        pq.write_table(table, path, compression="zstd", compression_level=3)
    return paths


def _split(head: str) -> tuple[str, str]:
    """Name and unit of a column's head."""
    found = _UNIT.fullmatch(head)
    return (found[1], found[2]) if found else (head, "")


def _fields(names: Sequence[str] | Mapping[str, Any]) -> list[str]:
    """Names as MATLAB allows them, each once."""
    stems = [re.sub(r"[^A-Za-z0-9]+", "_", clean(name, 28)).strip("_") or "x" for name in names]
    stems = [stem if stem[0].isalpha() else f"x{stem}" for stem in stems]
    return [stem if stems.index(stem) == i else f"{stem[:24]}_{i + 1}" for i, stem in enumerate(stems)]


def _struct(frame: pd.DataFrame) -> dict[str, Any]:
    """A frame as a struct of columns and a struct of their units."""
    columns, units = {}, {}
    heads = [_split(str(c)) for c in frame.columns]
    for field, (_, unit), column in zip(_fields([name for name, _ in heads]), heads, frame.columns, strict=True):
        values = frame[column]
        plain_values = pd.api.types.is_bool_dtype(values) or pd.api.types.is_numeric_dtype(values)
        texts = None if plain_values else np.array([clean(value, 2000) for value in values], dtype=object)
        columns[field], units[field] = (values.to_numpy() if texts is None else texts)[:, None], unit
    return {**columns, "units": units}


def _mat(data: dict[str, Any], path: Path) -> Path:
    """A MATLAB 5 file; its head says no date, so that the same data gives the same bytes."""
    from scipy.io import savemat

    path.parent.mkdir(parents=True, exist_ok=True)
    savemat(path, data, do_compression=True, long_field_names=True, oned_as="column")
    with path.open("r+b") as file:
        file.write(b"MATLAB 5.0 MAT-file, written by pmabench".ljust(116))
    return path


def export_results(results: Results, form: str, out: Path) -> list[Path]:
    """Coefficients of analyses: `csv` and `parquet` into the folder `out`, the others as the file `out`.

    RecordError where it cannot be written; UsageError where a model for python-control or MuJoCo cannot be made.
    """
    with writing(out, "the export"):
        return _RESULTS[form](results, out)


def _results_csv(results: Results, out: Path) -> list[Path]:
    paths = []
    for name, analysis in zip(_names(results.analyses), results.analyses, strict=True):
        (out / name).mkdir(parents=True, exist_ok=True)
        paths += write_tables(analysis, out / name)
        if rows := surface_rows(analysis):
            paths.append(write_file(out / name / "surface.csv", csv_text(_displayed(rows), []), "the export"))
    return paths


def _displayed(rows: Sequence[Mapping[str, float]]) -> list[dict[str, float]]:
    """Rows of a surface in the units that people read."""
    units = {plain_head(name): (name, point_shown(name)[1]) for name in ("pressure", "contraction")}
    units |= {unit.plain_label(name): (name, unit) for name, unit in (("F", shown("force")), ("K", shown("stiffness")))}
    return [{head: row[name] / unit.scale for head, (name, unit) in units.items()} for row in rows]


def _surfaces(analyses: Sequence[Analysis]) -> dict[str, pd.DataFrame]:
    """The surface of each analysis that has one, SI with units in the heads."""
    quantities = {"pressure": "pressure", "contraction": "length", "F": "force", "K": "stiffness"}
    heads = {name: headed(name, quantity) for name, quantity in quantities.items()}
    named = zip(_names(analyses), map(surface_rows, analyses), strict=True)
    return {f"{name}-table": pd.DataFrame(rows).rename(columns=heads) for name, rows in named if rows}


def _names(analyses: Sequence[Analysis]) -> list[str]:
    return file_names([analysis.kind for analysis in analyses])


def _texts(frame: pd.DataFrame) -> pd.DataFrame:
    """Lists of trials as one text."""
    return frame.assign(trials=[" ".join(trials) for trials in frame["trials"]]) if "trials" in frame else frame


def _results_parquet(results: Results, out: Path) -> list[Path]:
    frames = {"estimates": _texts(results.to_frame()), "findings": results.findings(), "dropped": results.dropped()}
    frames |= _surfaces(results.analyses)
    return _parquet(frames, out, {"runs": " ".join(run for a in results.analyses for run in a.runs)})


def _results_mat(results: Results, out: Path) -> list[Path]:
    structs: dict[str, Any] = {}
    for field, analysis in zip(_fields([a.kind for a in results.analyses]), results.analyses, strict=True):
        structs[field] = {"estimates": _struct(_texts(estimates_frame([analysis]))), "simulated": analysis.simulated}
        for table in _surfaces([analysis]).values():
            structs[field]["table"] = _struct(table)
    return [_mat(structs, out)]


def _results_latex(results: Results, out: Path) -> list[Path]:
    parts = []
    for name, analysis in zip(_names(results.analyses), results.analyses, strict=True):
        title = kind_title(analysis.kind) + (" (simulated)" if analysis.simulated else "")
        found = [tables.Table("Coefficients over pressure", tables.coefficient_table([analysis]))]
        for n, table in enumerate([*found, *tables.other_tables(analysis)], 1):
            if len(table.frame):
                parts.append(latex_table(table.frame, f"{title}: {table.caption}", f"tab:{name}-{n}"))
    return [write_file(out, "\n".join(parts), "the export")]


def _results_json(results: Results, out: Path) -> list[Path]:
    data = {"schema": "pmabench.coefficients/1", "analyses": [plain(a.to_dict()) for a in results.analyses]}
    text = json.dumps(data, indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False)
    return [write_file(out, text + "\n", "the export")]


def _results_control(results: Results, out: Path) -> list[Path]:
    analysis, runs = _modelled(results)
    text = surface_text(analysis) if suits_surface(analysis) else control_text(control_model(analysis, runs), analysis)
    return [write_file(out, text, "the export")]


def _results_mujoco(results: Results, out: Path) -> list[Path]:
    analysis, runs = _modelled(results)
    if suits_surface(analysis):
        why = "a muscle as a surface remembers its past, which an actuator of MuJoCo does not"
        raise UsageError(f"{why}; give --format python-control")
    return [write_file(out, mujoco_text(mujoco_model(analysis, runs), analysis), "the export")]


def _modelled(results: Results) -> tuple[Analysis, list[RunData]]:
    """The first analysis that a model can be made of, else the first, with its runs."""
    able = [a for a in results.analyses if suits(a) or suits_surface(a)] or list(results.analyses)[:1]
    if not able:
        raise UsageError("there is no analysis to make a model of")
    return able[0], [run for run in results.runs if run.id in able[0].runs]


_RESULTS: dict[str, Callable[[Results, Path], list[Path]]] = {
    "csv": _results_csv,
    "parquet": _results_parquet,
    "mat": _results_mat,
    "latex": _results_latex,
    "json": _results_json,
    "python-control": _results_control,
    "mujoco": _results_mujoco,
}


_ESCAPES = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    '"': "''",
    "|": r"\textbar{}",
    "−": "$-$",
    "±": r"$\pm$",
    "×": r"$\times$",
    "·": r"$\cdot$",
    "°": r"$^\circ$",
    "ε": r"$\varepsilon$",
    "η": r"$\eta$",
    "θ": r"$\theta$",
    "φ": r"$\varphi$",
    "τ": r"$\tau$",
    "ω": r"$\omega$",
    "ψ": r"$\psi$",
    "α": r"$\alpha$",
    "π": r"$\pi$",
    "\u202f": r"\,",
    "’": "'",
    "“": "``",
    "”": "''",
    "–": "--",
    "…": r"\ldots{}",
}
_RAISED = dict(zip("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789", strict=True))


def escaped(text: object) -> str:
    """Any text so that TeX prints it and does nothing else; a sign that plain TeX lacks becomes `?`."""
    marked = re.sub(r"[\s]+", " ", clean(text, 10_000))
    marked = re.sub(f"[{''.join(_RAISED)}]+", lambda m: f"\0{''.join(_RAISED[sign] for sign in m[0])}\1", marked)
    known = _ESCAPES | {"\0": "$^{", "\1": "}$"}
    out = (known.get(sign, sign if sign.isascii() or sign.isalpha() else "?") for sign in marked)
    return "".join(out).replace("?`", "?{}`").replace("!`", "!{}`")


def typeset(text: object) -> str:
    """As `escaped`, with symbols of the field in mathematics: `F_ce [N]`."""
    out = ""
    for kind, part in symbol_parts(clean(text, 10_000)):
        if kind == "sub":
            out = out.removesuffix("$") + f"_\\mathrm{{{escaped(part)}}}$"
        elif kind == "symbol":
            out += f"${_ESCAPES.get(part, part).strip('$')}$"
        else:
            out += escaped(part)
    return out


COLUMN = 229.0
"""Width of a column [pt]: of `article` with two columns; that of IEEEtran is 252 pt."""
SIZES = (("footnotesize", 4.25), ("scriptsize", 3.98))
"""Sizes of text with the width of a digit of Computer Modern in them [pt]."""
GAP = 2.0
"""Half the space between columns [pt], `\\tabcolsep`."""
_WIDE = ((".,:;il'| []()·", 0.56), ("±×−mw%", 1.67), ("0123456789", 1.0), ("MWK", 2.06))
"""Signs with their width in digits."""
WRAPPED = 58.0
"""Width of a column of words that is broken into lines [pt]."""
TEXTS = ("method", "symbol", "quantity", "unit")
"""Columns of words; the others hold numbers."""


def latex_table(frame: Frame, caption: str, label: str) -> str:
    """A frame of text cells as `table`s with `tabular`, none wider than a column of a page.

    Columns in `TEXTS` are set left, the others right. What is too wide becomes several tables: one for each method,
    then some of the columns each, the first repeated; long words are broken into lines.
    """
    whole = [(frame, caption)]
    methods = list(dict.fromkeys(frame["method"])) if "method" in frame.columns else []
    if len(methods) > 1 and _width(frame, 0) > COLUMN:
        rows = {method: frame.where(cell == method for cell in frame["method"]) for method in methods}
        whole = [(part.without("method").filled(), f"{caption}; {name}") for name, part in rows.items()]
    elif len(methods) == 1 and len(frame.columns) > 2:
        whole = [(frame.without("method"), f"{caption}; {methods[0]}")]
    found = [part for one, words in whole for part in _narrow(one, words)]
    labels = [label if n == 0 else f"{label}-{n + 1}" for n in range(len(found))]
    return "\n".join(_table(part, words, name) for (part, words), name in zip(found, labels, strict=True))


def _narrow(frame: Frame, caption: str) -> list[tuple[Frame, str]]:
    """The frame, or parts of its columns that fit, each with the first column."""
    if _width(frame, len(SIZES) - 1) <= COLUMN or len(frame.columns) < 3:
        return [(frame, caption)]
    first, *rest = frame.columns
    parts: list[list[str]] = [[]]
    for column in rest:
        if parts[-1] and _width(frame.select([first, *parts[-1], column]), 0) > COLUMN:
            parts.append([])
        parts[-1].append(column)
    words = [caption, *[f"{caption} (continued)"] * (len(parts) - 1)]
    return [(frame.select([first, *part]), text) for part, text in zip(parts, words, strict=True)]


def _width(frame: Frame, size: int) -> float:
    """Width of the tabular [pt] in one of `SIZES`."""
    digit = SIZES[size][1]
    columns = [max(_letters(text) for text in (c, *frame[c])) * digit for c in frame.columns]
    wide = [min(w, WRAPPED) if c in TEXTS else w for c, w in zip(frame.columns, columns, strict=True)]
    return sum(wide) + 2 * GAP * len(wide)


def _letters(text: object) -> float:
    """Length of a text in digits of Computer Modern."""
    known = {sign: wide for signs, wide in _WIDE for sign in signs}
    words = clean(text, 10_000).replace("_", "")
    return sum(known.get(sign, 1.5 if sign.isupper() else 1.06) for sign in words)


def _table(frame: Frame, caption: str, label: str) -> str:
    columns = frame.columns
    size = next((n for n in range(len(SIZES)) if _width(frame, n) <= COLUMN), len(SIZES) - 1)
    wide = {c for c in columns if max(map(_letters, (c, *frame[c]))) * SIZES[size][1] > WRAPPED}
    looks = ["r" if c not in TEXTS else rf"p{{{WRAPPED:.0f}pt}}" if c in wide else "l" for c in columns]
    lines = [
        r"\begin{table}",
        rf"\caption{{{typeset(caption)}}}",
        rf"\label{{{re.sub(r'[^A-Za-z0-9:-]', '-', label)}}}",
        rf"\{SIZES[size][0]}\setlength{{\tabcolsep}}{{{GAP:.0f}pt}}",
        rf"\begin{{tabular}}{{{''.join(looks)}}}",
        r"\hline",
        " & ".join(typeset(c) for c in columns) + r" \\",
        r"\hline",
        *(" & ".join(typeset(value) for value in row) + r" \\" for row in frame.cells()),
        r"\hline",
        r"\end{tabular}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"
