"""The door to pyarrow, which declares no types: what comes through it is `Any`, and nothing else is in here."""

from __future__ import annotations

from typing import Any

import pyarrow
import pyarrow.csv
import pyarrow.parquet

pa: Any = pyarrow
pq: Any = pyarrow.parquet
arrow_csv: Any = pyarrow.csv
