"""What a run's specimen file already believes of the muscle, to compare the measured with; fits nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pmabench.analysis.trial import Expected
from pmabench.base.errors import InvalidFile


def read_expected(folder: Path) -> Expected | None:
    """`expected` of the specimen file that a run was made from; None where there is none that can be read."""
    from pmabench.bench.files.specimen import SpecimenFile
    from pmabench.files.document import read_document, validate

    try:
        expected = validate(SpecimenFile, read_document(folder / "specimen.yaml")).expected
    except InvalidFile:
        return None
    if expected is None:
        return None
    points = sorted(expected.points, key=lambda point: point.pressure)
    columns = {name: np.array([getattr(p, name) for p in points]) for name in ("pressure", "F_ce", "K", "B_c", "B_r")}
    return Expected(source=expected.source, F_c=expected.F_c, **columns)
