"""A new calibration file from a fit; no file is ever changed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from datetime import date
from pathlib import Path

from pmabench.base.errors import RecordError
from pmabench.base.quantities import QUANTITIES, show
from pmabench.bench.channels import read_calibration
from pmabench.session.fit import Fit


def write_calibration(
    folder: Path,
    channel: str,
    quantity: str,
    raw_unit: str,
    found: Fit,
    *,
    reference: str,
    run: str,
    today: date,
    valid_until: date | None = None,
    sensor_lag: float = 0.0,
) -> Path:
    """Write `folder`/ID.yaml, ID = CHANNEL-DATE (with -2, -3 ... where taken); read it back as a bench would.

    Raises RecordError where it cannot be written.
    """
    text = "".join(f"{line}\n" for line in _lines(channel, quantity, raw_unit, found, reference, run))
    made: Path | None = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in _names(channel, today):
            path = folder / f"{name}.yaml"
            try:
                with path.open("x", encoding="utf-8") as stream:
                    made = path
                    stream.write(f"schema: pmabench.calibration/1\nid: {name}\n{text}date: {today.isoformat()}\n")
                    if valid_until is not None:
                        stream.write(f"valid_until: {valid_until.isoformat()}\n")
                    if sensor_lag:
                        stream.write(f"sensor_lag: {1e3 * sensor_lag:.6g} ms\n")
                    stream.flush()
                    os.fsync(stream.fileno())
            except FileExistsError:
                continue
            read_calibration(path, quantity)
            return path
    except OSError as error:
        if made is not None:
            made.unlink(missing_ok=True)
        raise RecordError(f"{folder}: the calibration cannot be written: {error.strerror or error}") from error
    raise RecordError(f"{folder}: no name is left for a calibration of {channel} of today")


def _names(channel: str, today: date) -> Iterator[str]:
    first = f"{channel.replace('_', '-').upper()}-{today:%Y%m%d}"
    yield first
    for number in range(2, 100):
        yield f"{first}-{number}"


def _lines(channel: str, quantity: str, raw_unit: str, found: Fit, reference: str, run: str) -> Iterator[str]:
    shown = QUANTITIES[quantity]
    yield f"quantity: {quantity}"
    yield f"reference: {json.dumps(reference, ensure_ascii=False)}"
    yield "points:"
    for raw, value in found.points:
        yield f"  - [{raw:.10g} {raw_unit}, {value / shown.scale:.10g} {shown.shown_in}]"
    yield f"expanded_uncertainty: {_up(found.expanded / shown.scale)} {shown.shown_in}"
    yield f"# of {channel}, by the run {run}"
    parts = {"reference": found.reference, "largest residual": found.residual, "hysteresis": found.hysteresis}
    parts |= {"repeatability (1 s)": found.repeatability, "drift": found.drift}
    yield "# from " + ", ".join(f"{name} {show(value, quantity, 3)}" for name, value in parts.items())


def _up(value: float) -> str:
    """Three digits, never rounded down."""
    text = f"{value:.3g}"
    return text if float(text) >= value else f"{value * 1.005:.3g}"
