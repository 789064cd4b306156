"""Tables, figures and the characterisation report; nothing here computes an estimate.

- `document`: what the report says, and as HTML, PDF and workbook; `templates` are its pages
- `figures`: every picture in it
- `pages`: other pages: bench card, comparison, history, a fitted model
- `cascade`: chains of muscles, drawn and animated
- `files`: analyses as files, for us and for other programs
- `many`: reports over thousands of runs
- `words`: names, symbols, rounding
- on a terminal: `terminal_coefficients`, `terminal`
"""
