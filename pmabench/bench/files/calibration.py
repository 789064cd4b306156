"""The calibration file: reference points, and how well they are known."""

from __future__ import annotations

import datetime
from typing import Annotated, Literal

from pydantic import Field

from pmabench.bench.files.parts import RatioNotBelow0, Reading, Text
from pmabench.files.document import Strict
from pmabench.files.quantity import Time


class CalibrationFile(Strict):
    """A calibration: reference points, and how well they are known (95 %, k = 2)."""

    schema_: Annotated[Literal["pmabench.calibration/1"], Field(alias="schema")]
    id: Text
    quantity: Literal["pressure", "force", "length", "angle"]
    reference: Text
    date: datetime.date
    valid_until: datetime.date | None = None
    points: Annotated[list[tuple[Reading, Reading]], Field(min_length=2, max_length=200)]
    expanded_uncertainty: Reading
    gain_uncertainty: RatioNotBelow0 = 0.0
    sensor_lag: Time = 0.0
