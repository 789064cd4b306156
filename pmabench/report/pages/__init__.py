"""Other pages than the report.

- `bench_card`; `comparison_page` with `comparison_tables`; `history_page` with `history_tables`; all on `page`
- a fitted model: `fit_figure`; what recalibration changed: `change_tables`
"""
