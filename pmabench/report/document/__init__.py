"""What a report says, before any format, and the formats.

- `content`, made of `front` (first page), `provenance`, `deviations`, `checklist`, `citation`, `run_notes`, `parents`
  (trials behind a number), `tables`, `wide_tables`, `budget_tables`, `check_tables`, `recalibration_tables`
- as HTML page, PDF, workbook: `html`, `pdf` (made smaller by `pdf_compact`), `workbook`; tables ready for any of
  them: `grids`
"""
