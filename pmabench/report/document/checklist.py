"""What ISO/IEC 17025:2017, 7.8.2 and 7.8.3, asks of a report, and whether this one has it; names what is missing.

The clauses are in our own words. No run holds a laboratory's name, its customer and who authorises: whoever
writes the report gives them (`Issuer`). Nothing here says that a laboratory is accredited.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from pmabench.plotting.wording import clean
from pmabench.report.document.provenance import get
from pmabench.store.analyses.results import Analysis, Estimate
from pmabench.store.records import RunData


@dataclass(frozen=True)
class Issuer:
    """Who issues the report; empty where it was not given."""

    laboratory: str = ""
    """Name and address."""
    customer: str = ""
    authorised_by: str = ""
    issued: str = ""
    """Date of issue."""

    def cleaned(self) -> Issuer:
        """The same without control characters and cut to a line."""
        return Issuer(*(clean(text, 300) for text in vars(self).values()))


@dataclass(frozen=True)
class Item:
    """One line of the checklist."""

    clause: str
    asked: str
    there: bool
    said: str
    """Where it is, or what to do."""


def checklist(
    analyses: Sequence[Analysis],
    runs: Sequence[RunData],
    issuer: Issuer,
    *,
    specimen: str,
    when: str,
    deviations: Sequence[str],
    accepted: bool,
) -> list[Item]:
    """Every clause that applies to tests; sampling (7.8.5) and calibration certificates (7.8.4) do not."""
    estimates = [e for a in analyses for e in a.estimates if e.value is not None]
    sources = all(run.manifest.get("source") or run.manifest.get("protocol") for run in runs) and bool(runs)
    mounted = all(get(run.manifest, "specimen", "mounted") for run in runs) and bool(runs)
    session = all(run.manifest.get("session") for run in runs) and bool(runs)
    return [
        Item("7.8.2.1 a", "a title", True, "first page"),
        _asked("7.8.2.1 b, c", "the laboratory, its address, where it was tested", issuer.laboratory, "--laboratory"),
        Item("7.8.2.1 d", "an identification on every page", True, "the report's number is at the foot of each page"),
        _asked("7.8.2.1 e", "the customer", issuer.customer, "--customer"),
        _either("7.8.2.1 f", "the method", sources, "Protocol, Methods", "name the source in the protocol"),
        _either("7.8.2.1 g", "the item, unmistakably", bool(specimen), specimen, "give make, type and serial number"),
        _either("7.8.2.1 g", "its condition", mounted, "first page", "give the specimen's `mounted` in its file"),
        _either("7.8.2.1 i", "dates of the tests", bool(when), when, "the runs are not at hand"),
        _asked("7.8.2.1 j", "date of issue", issuer.issued, "--issued"),
        Item("7.8.2.1 l", "“relates only to the items tested”", True, "Provenance"),
        _either("7.8.2.1 m", "results with units", bool(estimates), "first page, All values", "there is no result"),
        Item(
            "7.8.2.1 n",
            "deviations, additions, exclusions",
            bool(runs),
            f"{len(deviations)} remarks under Protocol and deviations" if runs else "the runs are not at hand",
        ),
        _asked("7.8.2.1 o", "who authorises the report", issuer.authorised_by, "--authorised-by"),
        _either(
            "7.8.3.1 a",
            "test conditions",
            session,
            "warm-up, self-test and zeros: session of each run",
            "no session with zeros and supply is in the record; room temperature and supply are not known",
        ),
        Item(
            "7.8.3.1 b",
            "conformity, where it is asked for",
            True,
            "first page" if accepted else "not asked for: the protocols set no acceptance limits (`accept`)",
        ),
        *_measurement(estimates, runs),
    ]


def _measurement(estimates: Sequence[Estimate], runs: Sequence[RunData]) -> Iterator[Item]:
    """Uncertainty of the values, and calibration of the channels behind them."""
    without = sum(e.ci95 is None for e in estimates)
    yield _either(
        "7.8.3.1 c",
        "measurement uncertainty",
        bool(estimates) and without == 0,
        "Intervals in parts",
        f"{without} of {len(estimates)} values have no interval; Intervals in parts says why",
    )
    measured = {c for run in runs for c in run.channels.values() if not c.name.endswith("_command")}
    uncalibrated = sorted({clean(c.name, 40) for c in measured if not c.calibration})
    yield _either(
        "6.5",
        "calibrations of the channels",
        bool(runs) and not uncalibrated,
        "Provenance",
        f"without calibration: {', '.join(uncalibrated)}" if uncalibrated else "the runs are not at hand",
    )


def _asked(clause: str, asked: str, answer: str, option: str) -> Item:
    return Item(clause, asked, bool(answer), answer or f"not given; use {option}, or write it by hand")


def _either(clause: str, asked: str, there: bool, where: str, otherwise: str) -> Item:
    return Item(clause, asked, there, where if there else otherwise)
