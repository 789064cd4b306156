"""The tool that drives the browser: what it reports is what the page did."""

import time

import pytest

PAGE = "data:text/html,<title>first</title><button id=b onclick='document.title=event.isTrusted'>go</button>"


def test_a_page_is_clicked_and_read(browser):
    page = browser.open(PAGE)
    page.click("#b")
    page.wait("document.title === 'true'", within=2.0)
    assert (page.text("#b"), page.problems) == ("go", [])
    page.close()


def test_what_the_console_says_is_a_problem(browser):
    page = browser.open("data:text/html,<script>console.error('one'); setTimeout(() => {throw Error('two')})</script>")
    page.wait("new Promise(done => setTimeout(() => done(true), 50))")
    assert [problem.splitlines()[0] for problem in page.problems] == ["one", "Error: two"]
    page.close()


def test_a_breach_of_the_policy_is_a_problem(browser):
    policy = "<meta http-equiv=Content-Security-Policy content=\"script-src 'none'\">"
    page = browser.open(f"data:text/html,{policy}<script>document.title = 'ran'</script>")
    assert page.run("document.title") == ""
    assert "Content Security Policy" in page.problems[0]
    page.close()


def test_what_does_not_come_true_ends_after_its_time(browser):
    page = browser.open(PAGE)
    began = time.monotonic()
    with pytest.raises(AssertionError, match="not true: document.title === 'never'"):
        page.wait("document.title === 'never'", within=0.2)
    assert time.monotonic() - began < 2.0
    page.close()


def test_a_page_is_printed_on_a4(browser, tmp_path):
    from pypdf import PdfReader

    page = browser.open(PAGE)
    page.pdf(tmp_path / "a.pdf")
    [sheet] = PdfReader(tmp_path / "a.pdf").pages
    assert (float(sheet.mediabox.width), float(sheet.mediabox.height)) == pytest.approx((595, 842), abs=1.5)
    page.close()
