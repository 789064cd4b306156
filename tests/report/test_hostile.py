"""Free text does nothing but stand there: in the page, the workbook, the PDF, CSV, LaTeX and on the terminal."""

import csv
import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import openpyxl
import pypdf
import pytest
from click.testing import CliRunner
from rich.console import Console

from pmabench.cli.main import main
from pmabench.notebook import Results
from pmabench.plotting.wording import clean
from pmabench.report.document.content import content_of, page_of
from pmabench.report.document.deviations import Issuer
from pmabench.report.document.formats import pdf_bytes, workbook_bytes
from pmabench.report.files.export import escaped, export_results
from pmabench.report.files.simulator_models import control_model, control_text
from pmabench.report.foremost import print_coefficients
from pmabench.store.analyses.results import Analysis, Dropped, Estimate, Finding, Parts, Trace
from pmabench.store.notes import Note, add_note
from tests.store.runs import begin, record

from . import samples
from .hostile import PAYLOADS

ACTIVE = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def analyses() -> list[Analysis]:
    """Every payload in every text of an analysis."""
    at = [{"pressure": 1e5 + 100.0 * n} for n in range(len(PAYLOADS))]
    estimates = tuple(
        Estimate(p if n % 3 else "K", 1.0 + n, p, p, p, at[n], Parts(0.1), note=p, trials=(p,), coordinate=p)
        for n, p in enumerate(PAYLOADS)
    )
    t = np.arange(5.0)
    traces = tuple(Trace(p, p, p, {"t": t, p: t}, {"t": "time", p: p}, {p: 1.0}) for p in PAYLOADS[::40])
    found = Analysis(
        PAYLOADS[0],
        tuple(PAYLOADS),
        True,
        estimates=estimates,
        dropped=tuple(Dropped(p, {"pressure": 1e5, p: 1.0}, p) for p in PAYLOADS),
        findings=tuple(Finding("fault" if n % 2 else p, p) for n, p in enumerate(PAYLOADS)),
        traces=traces,
    )
    return [found, replace(samples.static_load(), kind=PAYLOADS[13])]


def runs() -> list:
    return [
        replace(
            samples.run(
                "static-load",
                specimen={"make": p, "type": p, "serial": p},
                bench={"name": p},
                devices={p: {"maker": p, "model": p}},
                protocol=p,
                source=p,
                operator=p,
                why=p,
                deviations=PAYLOADS,
                versions={p: p},
            ),
            id=p,
            status=p,
            notes=tuple(Note(i, p, p, p, i, p, (p,)) for i, p in enumerate(PAYLOADS)) if not n else (),
        )
        for n, p in enumerate(PAYLOADS[::25])
    ]


@pytest.fixture(scope="module")
def content():
    reported = Issuer(PAYLOADS[1], PAYLOADS[14], PAYLOADS[26], PAYLOADS[40])
    return content_of(analyses(), runs(), title=PAYLOADS[2], issuer=reported)


def test_there_are_two_hundred():
    assert len(set(PAYLOADS)) >= 200


KNOWN = """html head meta title style body main section header div nav a p h1 h2 h3 b i sub span em strong br ul li dl dt
dd ol aside code script table caption thead tbody tr th td figure figcaption details summary pre svg desc defs g path rect use text tspan
clippath"""


class Tags(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.words.append(data)


def test_nothing_acts_on_the_page(content):
    text = page_of(content)
    page = Tags(text)
    known = set(KNOWN.split())
    assert {tag for tag, _ in page.tags} <= known
    for _, attributes in page.tags:
        assert not any(name.startswith("on") for name in attributes)
        assert attributes.get("href", "#").startswith("#")
        assert not {"src", "srcdoc", "action", "formaction", "background"} & set(attributes)
    assert ACTIVE.search(text) is None
    shown = " ".join("".join(page.words).split())
    for payload in PAYLOADS[: len(PAYLOADS) // 4]:
        assert " ".join(clean(payload, 300).split())[:40] in shown or "{" in payload or "_" in payload


@pytest.mark.parametrize("analysis", samples.all_analyses(), ids=lambda one: one.kind)
def test_columns_that_share_no_row_make_a_page(analysis):
    one = np.array([1.0, 2.0, np.nan, np.nan])
    traces = [
        replace(t, columns={name: one[:: -1 if n else 1] for n, name in enumerate(t.columns)}) for t in analysis.traces
    ]
    assert "</html>" in page_of(content_of([replace(analysis, traces=tuple(traces))], []))


def test_nothing_acts_in_the_workbook(content):
    book = openpyxl.load_workbook(io.BytesIO(workbook_bytes(content, analyses())))
    texts = 0
    for sheet in book:
        for row in sheet.iter_rows():
            for cell in row:
                assert cell.data_type != "f"
                assert cell.hyperlink is None
                if isinstance(cell.value, str):
                    texts += 1
                    assert cell.value.lstrip()[:1] not in ("=", "+", "-", "@", "＝", "＋", "－", "＠")
                    assert ACTIVE.search(cell.value.replace("_x000D_", "")) is None
    assert texts > 1000
    assert not book.defined_names


def test_nothing_acts_in_the_pdf(content):
    few = replace(content, notes=content.notes[:60], compared=[])
    few = replace(few, sections=[])  # a table of 200 columns takes typst ten seconds
    reader = pypdf.PdfReader(io.BytesIO(pdf_bytes(few)))
    words = ""
    for n, page in enumerate(reader.pages):
        words += page.extract_text() if n in (0, 2) else ""
        for annotation in page.get("/Annots") or []:
            action = annotation.get_object().get("/A", {})
            assert action.get("/S") not in ("/URI", "/JavaScript", "/Launch")
    assert "/Names" not in reader.root_object or "/JavaScript" not in reader.root_object["/Names"]
    assert "/OpenAction" not in reader.root_object
    assert "alert" in words, "the text stands there as text"


def test_nothing_acts_in_csv(tmp_path):
    for path in export_results(Results(tuple(analyses()), ()), "csv", tmp_path):
        text = path.read_bytes().decode("utf-8")
        assert ACTIVE.search(text) is None
        for row in csv.reader(io.StringIO(text)):
            for cell in row:
                number = re.fullmatch(r"-?[\d.]+(e[+-]?\d+)?", cell)
                assert number or cell.lstrip()[:1] not in ("=", "+", "-", "@", "＝", "＋", "－", "＠")


COMMANDS = {"textbackslash", "textasciicircum", "textasciitilde", "textless", "textgreater", "textbar", "pm", "times"}
COMMANDS |= {
    "cdot",
    "circ",
    "varepsilon",
    "theta",
    "varphi",
    "tau",
    "omega",
    "alpha",
    "pi",
    "ldots",
    "mathrm",
    "caption",
}
COMMANDS |= {"begin", "end", "label", "hline"}


def test_nothing_acts_in_latex(tmp_path):
    (path,) = export_results(Results(tuple(analyses()), ()), "latex", tmp_path / "t.tex")
    text = path.read_text(encoding="utf-8")
    assert set(re.findall(r"\\([A-Za-z]+)", text)) <= COMMANDS | {
        "footnotesize",
        "scriptsize",
        "setlength",
        "tabcolsep",
    }
    assert set(re.findall(r"\\(begin|end)\{(\w+)\}", text)) <= {
        (word, name) for word in ("begin", "end") for name in ("table", "tabular")
    }
    for payload in PAYLOADS:
        reported = escaped(payload)
        assert set(re.findall(r"\\([A-Za-z]+)", reported)) <= COMMANDS - {
            "begin",
            "end",
            "label",
            "hline",
            "caption",
            "mathrm",
        }
        bare = re.sub(r"\\[A-Za-z]+(\{\})?|\\[{}$&#%_,]|\$\^\\circ\$|\$-\$|\$\^\{[-\d]+\}\$|\$\$", "", reported)
        assert not set(bare) & set("\\&#%_~"), payload
        depth = 0
        for sign in re.sub(r"\\[{}]", "", reported):
            depth += {"{": 1, "}": -1}.get(sign, 0)
            assert depth >= 0
        assert depth == 0


def test_nothing_acts_on_the_terminal():
    console = Console(file=io.StringIO(), width=100, color_system=None)
    print_coefficients(analyses(), console)
    assert ACTIVE.search(console.file.getvalue()) is None


def test_nothing_acts_in_an_exported_model():
    steps = replace(samples.contraction(), runs=tuple(f'"""\n{p}' for p in PAYLOADS))
    text = control_text(control_model(steps), steps)
    compile(text, "model.py", "exec")
    assert text.count('"""') == 8
    assert ACTIVE.search(text) is None
    renamed = tuple(
        replace(e, method='x"""\n' + PAYLOADS[2]) for e in steps.estimates if e.method == "measured-pressure"
    )
    compile(control_text(control_model(replace(steps, estimates=renamed)), steps), "model.py", "exec")


def test_nothing_of_a_run_acts_on_the_terminal(tmp_path):
    evil = "\x1b]0;t\x07\x1b[2J\x9b31m\u202eX"
    specimen = {"make": evil, "type": evil, "serial": evil}
    writer = begin(tmp_path, operator=evil, protocol=evil, source=evil, bench=evil, specimen=specimen)
    record(writer)
    writer.close("finished")
    add_note(writer.folder, evil, operator=evil)
    add_note(writer.folder, exclude=0, because=evil, operator=evil)
    page = str(tmp_path / "r.html")
    for command in ("runs list {}", "runs show {}/run", "process {}/run", f"report {{}}/run -o {page}"):
        said = CliRunner().invoke(main, [word.format(tmp_path) for word in command.split()])
        assert said.exit_code in (0, 6)
        assert ACTIVE.search(said.output) is None, command
        assert "X" in said.output or "report" in command
