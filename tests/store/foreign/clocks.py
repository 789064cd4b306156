"""Files whose time is written in every other way than seconds from 0 (finding 9)."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime, timedelta

import numpy as np

from tests.store.foreign.case import NAME, RATE, Case, Measured, clean, commas, fixed, lines, text

STARTED = datetime(2026, 3, 4, 10, 0, 0)
DAY_ZERO = datetime(1899, 12, 30)
"""Of the serial days of spreadsheets."""
CLOCK = r"time|clock|stamp|date|rate|sampl"


def _stamps(test: Measured, form: str, started: datetime = STARTED) -> list[str]:
    """Each row's time of day; %f in the form is cut to milliseconds."""
    found = []
    for at in test.t:
        now = started + timedelta(seconds=float(at))
        found.append(now.strftime(form.replace("%f", f"{now.microsecond // 1000:03d}")))
    return found


def _case(
    name: str, header: list[str], stamps: Iterable[str], test: Measured, clock: float = 2e-3, words: str = CLOCK,
    *, damaged: bool = False, must: bool = False,
) -> Case:  # fmt: skip
    rows = lines([stamps, fixed(test.P), fixed(test.F)])
    return Case(name, "clocks", {NAME: text(header, rows)}, words, (test,), clock=clock, damaged=damaged, must=must)


def _german() -> Case:
    test = clean(80)
    dates, clocks = _stamps(test, "%d.%m.%Y"), _stamps(test, "%H:%M:%S,%f")
    rows = lines([dates, clocks, commas(test.P), commas(test.F)], ";")
    file = text(["Datum;Uhrzeit;Druck [kPa];Kraft [N]"], rows)
    return Case("date and clock in two columns, German", "clocks", {NAME: file}, CLOCK, (test,), must=True)


def _scope() -> Case:
    """What an oscilloscope writes: a number for each row, and what it means in the head."""
    test = clean(81)
    rows = [f"{n},{P},{F},," for n, (P, F) in enumerate(zip(fixed(test.P), fixed(test.F), strict=True))]
    header = ["X,pressure,force,Start,Increment", "Sequence,kPa,N,0.000000e+00,1.000000e-02"]
    words = r"increment|start|sequence|period|rate|time"
    return Case(
        "oscilloscope with Start and Increment", "clocks", {NAME: text(header, rows)}, words, (test,), must=True
    )


def _commas_only() -> Case:
    test = clean(82)
    rows = lines([commas(test.t), commas(test.P), commas(test.F)])
    words = r"comma|decimal|delimiter|ambig|columns"
    return Case(
        "comma as delimiter and decimal sign",
        "clocks",
        {NAME: text(["time (s),pressure (kPa),force (N)"], rows)},
        words,
        (test,),
    )


def _zero_record() -> Case:
    """The first of two pressure columns is the zero that was taken before the test."""
    test = clean(83)
    rows = lines([fixed(test.t), ["0.00"] * len(test.t), fixed(test.P), fixed(test.F)])
    file = text(["time (s),pressure zero (kPa),pressure (kPa),force (N)"], rows)
    words = r"zero|two columns|constant|which|both"
    return Case("a zero record before the pressure", "clocks", {NAME: file}, words, (test,))


def _two_clocks() -> Case:
    """The controller's clock goes in steps of 0.1 s and counts from another moment, that of the converter is good."""
    test = clean(84)
    plc = np.floor(10 * (test.t + 41.7)) / 10
    rows = lines([fixed(plc, 1), fixed(test.t), fixed(test.P), fixed(test.F)])
    file = text(["time PLC (s),time DAQ (s),pressure (kPa),force (N)"], rows)
    return Case("two clocks", "clocks", {NAME: file}, r"two|which|clock|both|time plc|stamps equal|twice", (test,))


def _wrapped() -> Case:
    """A microcontroller's counter of milliseconds passes 2^32."""
    test = clean(85)
    ticks = (4294952296 + np.rint(1e3 * test.t).astype(np.int64)) % 2**32
    return _case("milliseconds that pass 2^32", ["millis (ms),pressure (kPa),force (N)"], map(str, ticks), test,
                 words=r"time.?jump|wrap|overflow|back|clock|2\^32|rising", damaged=True)  # fmt: skip


def _parts() -> Case:
    """Whole seconds in one column, milliseconds in the next."""
    test = clean(86)
    stamps, rest = _stamps(test, "%Y-%m-%d %H:%M:%S"), (f"{round(1e3 * (at % 1.0)) % 1000:03d}" for at in test.t)
    rows = lines([stamps, rest, fixed(test.P), fixed(test.F)])
    file = text(["timestamp,ms,pressure (kPa),force (N)"], rows)
    return Case("seconds and milliseconds in two columns", "clocks", {NAME: file}, CLOCK, (test,))


def cases() -> list[Case]:
    """One of each way to write time."""
    test = clean(90)
    units = ",pressure (kPa),force (N)"
    days = [f"{(STARTED - DAY_ZERO) / timedelta(days=1) + at / 86400:.10f}" for at in test.t]
    epoch = (STARTED - datetime(1970, 1, 1)).total_seconds()
    counted = [str(n) for n in range(len(test.t))]
    night = datetime(2026, 3, 4, 23, 59, 50)
    minutes = [f"{int(at // 60):02d}:{at % 60:06.3f}" for at in test.t]
    millis, micros = np.rint(1e3 * test.t).astype(int), np.rint(1e6 * test.t).astype(int)
    known = f"Sample rate: {RATE:g} Hz"
    return [
        _case("ISO stamps", [f"timestamp{units}"], _stamps(test, "%Y-%m-%dT%H:%M:%S.%f"), test, must=True),
        _case(
            "ISO stamps with a zone",
            [f"timestamp{units}"],
            _stamps(test, "%Y-%m-%d %H:%M:%S.%f+01:00"),
            test,
            must=True,
        ),
        _case("clock", [f"time{units}"], _stamps(test, "%H:%M:%S.%f"), test, must=True),
        _case("clock past midnight", [f"time{units}"], _stamps(test, "%H:%M:%S.%f", night), test, must=True),
        _case("clock in whole seconds", [f"time{units}"], _stamps(test, "%H:%M:%S"), test, clock=1.01),
        _case(
            "American date and time", [f"Date/Time{units}"], _stamps(test, "%m/%d/%Y %I:%M:%S.%f %p"), test, must=True
        ),
        _case("serial days", [f"time{units}"], days, test, must=True),
        _case("serial days called date", [f"date{units}"], days, test),
        _case("epoch in seconds", [f"time{units}"], fixed(epoch + test.t), test, must=True),
        _case(
            "epoch in milliseconds", [f"timestamp{units}"], map(str, np.int64(1000 * epoch) + millis), test, must=True
        ),
        _case("microseconds", [f"time (us){units}"], map(str, micros), test),
        _case("minutes and seconds", [f"elapsed{units}"], minutes, test),
        _case("numbers of rows, rate in the head", [known, f"sample{units}"], counted, test, must=True),
        _case("numbers of rows, no rate", [f"sample{units}"], counted, test, words=r"rate|period|\?\?|time"),
        _case(
            "clock of 12 hours past 12:59:59",
            [f"time{units}"],
            _stamps(test, "%I:%M:%S.%f", datetime(2026, 3, 4, 12, 59, 50)),
            test,
        ),
        _case("minutes", [f"time (min){units}"], fixed(test.t / 60, 6), test),
        _case(
            "seconds labelled ms", [f"time (ms){units}"], fixed(test.t), test, words=CLOCK + r"|ms|unit", damaged=True
        ),
        _parts(),
        _german(),
        _scope(),
        _commas_only(),
        _zero_record(),
        _two_clocks(),
        _wrapped(),
    ]
