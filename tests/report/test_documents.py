"""PDF and workbook: the content of the page, read back by other programs; each figure is described."""

import base64
import io
import re
import sys
from dataclasses import replace
from xml.etree import ElementTree

import openpyxl
import pypdf
import pytest

from pmabench.base.errors import UsageError
from pmabench.report.document.content import content_of, page_of, write_figures
from pmabench.report.document.deviations import Said
from pmabench.report.document.formats import pdf_bytes, workbook_bytes, write_pdf, write_workbook
from pmabench.store.analyses.results import Parts, Source

from . import samples
from .test_run_notes import PNG


@pytest.fixture(scope="module")
def content():
    return content_of(samples.all_analyses(), samples.all_runs(), title="Characterisation of a muscle 筋")


@pytest.fixture(scope="module")
def pdf(content):
    return pdf_bytes(content)


def alternatives(element, seen: set) -> list[str]:
    """Alternative texts of figures in the structure tree of a PDF."""
    element = element.get_object()
    if id(element) in seen or not isinstance(element, dict):
        return []
    seen.add(id(element))
    found = [str(element["/Alt"])] if element.get("/S") == "/Figure" and "/Alt" in element else []
    children = element.get("/K", [])
    for child in children if isinstance(children, list) else [children]:
        if hasattr(child, "get_object"):
            found += alternatives(child, seen)
    return found


def test_the_pdf_is_tagged_and_describes_every_figure(content, pdf):
    reader = pypdf.PdfReader(io.BytesIO(pdf))
    root = reader.root_object
    assert root["/MarkInfo"]["/Marked"]
    assert root["/Lang"] == "en"
    assert reader.metadata.title == content.title
    assert b"pdfuaid" in reader.xmp_metadata.stream.get_data()
    reported = alternatives(root["/StructTreeRoot"], set())
    pictures = [item.picture for item in [*content.front, *(f for s in content.sections for f in s.figures)]]
    assert set(reported) >= {picture.alt for picture in pictures}
    assert len(pictures) >= 10


def test_figures_as_files_of_their_own_are_whole_and_at_their_size_in_print(content, tmp_path):
    """Each SVG is XML by itself, as wide as at most the text of an A4 page, refers to nothing and says SIMULATED."""
    folder = write_figures(content, tmp_path / "figures")
    files = sorted(folder.glob("*.svg"))
    pictures = [item.picture for item in [*content.front, *(f for s in content.sections for f in s.figures)]]
    assert len(files) == len(pictures)
    captions = (folder / "captions.txt").read_text("utf-8")
    for number, (path, picture) in enumerate(zip(files, pictures, strict=True), start=1):
        root = ElementTree.fromstring(path.read_bytes())
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert 72 < float(root.get("width").removesuffix("pt")) <= 7.3 * 72
        assert not [value for one in root.iter() for key, value in one.items() if "href" in key and value[0] != "#"]
        assert "SIMULATED" in "".join(root.itertext())
        assert f"{path.name}\n  Figure {number}: {picture.title}" in captions


def test_the_pdf_says_what_the_page_says(content, pdf):
    reader = pypdf.PdfReader(io.BytesIO(pdf))
    first = " ".join(reader.pages[0].extract_text().split())
    for words in (content.verdict.word, "SIMULATED", content.report_id, "Figure 2", "What this does not hold for"):
        assert words in first
    assert 4 < len(reader.pages) < 40
    assert len(pdf) < 1_000_000


def fonts_of(pdf: bytes) -> set[str]:
    return {
        str(font.get_object()["/BaseFont"]).partition("+")[2].partition("-")[0]
        for page in pypdf.PdfReader(io.BytesIO(pdf)).pages
        for font in page["/Resources"]["/Font"].values()
    }


def test_the_fonts_of_the_pdf_come_with_the_package_and_the_program(pdf):
    """Not from the machine, but for a script that they lack: there it is one more font, or one of boxes."""
    ours = {"Inter", "DejaVuSansMono", "LibertinusSerif", "NewCM10", "NewCMMath"}
    assert "Inter" in fonts_of(pdf)
    assert len(fonts_of(pdf) - ours) == 1
    assert fonts_of(pdf_bytes(content_of([samples.static_load()], []))) <= ours


def test_appendices_have_the_names_of_the_page(content, pdf):
    page = page_of(content)
    named = re.findall(r"<summary id=.*?><b>(\w)</b> ([^<\n]*\w)", page)
    outline = pypdf.PdfReader(io.BytesIO(pdf)).outline
    assert [entry.title.split(" ", 1) for entry in outline if not isinstance(entry, list)] == [[*one] for one in named]
    assert len(named) >= 8


def test_the_same_report_gives_the_same_bytes(content, pdf):
    assert pdf_bytes(content) == pdf
    analyses = samples.all_analyses()
    assert workbook_bytes(content, analyses) == workbook_bytes(content, analyses)


def test_the_workbook_holds_numbers_with_their_units(content, tmp_path):
    steps = samples.contraction()
    K = next(e for e in steps.estimates if e.symbol == "K" and e.at["pressure"] == 400e3)
    line = Source("calibration of pressure, offset", "calibration", "B", 0.5 * K.parts.combined)
    reported = replace(K, budget=(line,), parts=Parts(repeats=0.0, calibration=line.half))
    steps = replace(steps, estimates=(reported, *(e for e in steps.estimates if e is not K)))
    path = write_workbook(content, [steps], tmp_path / "sub" / "r.xlsx")
    book = openpyxl.load_workbook(path)
    sheet = book["Contraction and relaxation"]
    assert sheet["A2"].value == "SIMULATED"
    heads = [cell.value for cell in sheet[4]]
    rows = [dict(zip(heads, (c.value for c in row), strict=True)) for row in sheet.iter_rows(min_row=5)]
    row = next(row for row in rows if row["method"] == "measured-pressure" and row["P [kPa]"] == 400)
    assert row["K [N/mm]"] == pytest.approx(K.value / 1e3)
    column = sheet[sheet.cell(4, heads.index("K [N/mm]") + 1).column_letter]
    assert {cell.number_format for cell in column[4:] if isinstance(cell.value, float)} == {"0.0000"}, "five digits"
    budget = [[cell.value for cell in row] for row in book["Budgets"].iter_rows(min_row=4)]
    assert dict(zip(*budget[:2], strict=True))["half width 95 %"] == pytest.approx(line.half / 1e3)
    assert dict(zip(*budget[:2], strict=True))["share"] == pytest.approx(1.0)
    summary = {row[0].value: row[1].value for row in book["Summary"].iter_rows(min_row=4)}
    assert summary["Verdict"].startswith(content.verdict.word)


@pytest.mark.parametrize(("module", "extra"), [("typst", "pmabench[pdf]"), ("xlsxwriter", "pmabench[xlsx]")])
def test_without_the_extra_a_sentence_says_which(content, monkeypatch, tmp_path, module, extra):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UsageError) as reported:
        write_pdf(content, tmp_path / "x") if module == "typst" else write_workbook(content, [], tmp_path / "x")
    assert extra in str(reported.value)


def test_attached_files_are_named(content):
    pictures = (("rig.png", f"data:image/png;base64,{base64.b64encode(PNG).decode()}"),)
    said = Said("R1", "2026-11-22 10:00", "A. Meyer", "hose", pictures, ("log.txt",))
    few = replace(content, notes=[said], sections=[], front=[], curves=content.polynomials)
    reader = pypdf.PdfReader(io.BytesIO(pdf_bytes(few)))
    assert not any(page.images for page in reader.pages)
    words = " ".join(" ".join(page.extract_text() for page in reader.pages[:3]).split())
    assert "hose (attached: log.txt, rig.png)" in words
