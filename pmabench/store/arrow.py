"""Imports pyarrow as `Any`, since it declares no types; everything else takes it from here."""

from __future__ import annotations

from typing import Any

import pyarrow
import pyarrow.csv
import pyarrow.parquet

pa: Any = pyarrow
pq: Any = pyarrow.parquet
arrow_csv: Any = pyarrow.csv
DAMAGED: tuple[type[Exception], ...] = (pa.ArrowException, OSError, ValueError, KeyError, TypeError, RecursionError)
"""What reading damaged files raises."""
