"""What a report says, before any format, and the formats.

- `content`, also as an HTML page, made of `provenance`, `deviations` (with notes, and a checklist), `tables`,
  `special_tables`; tables ready for any format: `grids`
- `formats`: PDF and workbook
"""
