"""Other pages than the report.

- `bench_card`; `comparison_page` and `history_page`, with their tables
- a fitted model: `fit_figure`; what recalibration changed: `change_tables`
"""
