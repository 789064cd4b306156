"""Other pages than the report.

- `bench_card`; `comparison_page` (with what recalibration changed) and `history_page`, with their tables
- a fitted model: `fit_figure`
"""
