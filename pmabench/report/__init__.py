"""Tables, figures and the characterisation report; nothing here computes an estimate.

- what a report says, before any format: `content`, made of `front` (first page), `provenance`, `deviations`,
  `checklist`, `citation`, `run_notes`, `parents` (trials behind a number), `tables`, `budget_tables`, `figures`
- as HTML page, PDF, workbook: `html`, `pdf`, `workbook`, with `templates/`; tables ready for any of them: `grids`
- figures: `figures` says which ones an analysis has; each kind of test has its `..._figures`, which name and explain,
  and draw through `plots` and the `..._plots`; `pictures` and `svg` are what every figure is; `overlays` are published
  points in them
- words and numbers: `wording` (symbols, kinds, points), `method_words`, `rounding`
- on a terminal: `terminal_coefficients`, `terminal`
- analyses as files: `analysis_folder`, `csv_files`; for other programs: `export`, `latex`, `control_model` with
  `control_law`
- other pages: `bench_card`, `comparison_page` with `comparison_tables`, `history_page` with `history_tables`, both on
  `page`; a fitted model: `fit_figure`; what recalibration changed: `change_tables`
- chains of muscles: `cascade_page`, `cascade_drawing`, `cascade_figures`, `cascade_record`
- many runs: `many`, which works out only what has changed (`many_cache`), one by one (`processed`), into `many_table`
"""
