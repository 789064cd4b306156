"""What a reduction returns: the records of `store.analyses.results`, by the names that reductions use."""

from pmabench.store.analyses.results import (
    AGREEMENT,
    POINT_QUANTITIES,
    PUBLISHED,
    SCHEMA,
    Analysis,
    Curve,
    Dropped,
    Estimate,
    Finding,
    Parts,
    PublishedPoints,
    Source,
    Trace,
    withhold,
)

__all__ = [
    "AGREEMENT",
    "POINT_QUANTITIES",
    "PUBLISHED",
    "SCHEMA",
    "Analysis",
    "Curve",
    "Dropped",
    "Estimate",
    "Finding",
    "Parts",
    "PublishedPoints",
    "Source",
    "Trace",
    "withhold",
]
