"""Tables, figures and the characterisation report; nothing here computes an estimate.

- `certificate`: the first two pages of a report; `foremost`: verdict, values and findings that come first, there and on
  a terminal, whose tables `terminal` prints
- `document`: what the report says, and as HTML, PDF and workbook; `templates` are its pages; `writing`: pages and
  files, the card of a bench, and the last page of stored analyses, copied while nothing changed
- `figures`: which figures an analysis has, as its kind of test draws them; those of coefficients over an
  operating point; `overlays`: published points
- `other_pages`: comparison and history; `fit_figure` of a fitted model
- `cascade_record`, `cascade_page`: chains of muscles, drawn and animated
- `files`: analyses as files, for us and for other programs
- `publishing`: records, analyses and report as a package for a repository of research data
- `many`: reports over thousands of runs
- `words`: names of symbols, tests and methods
"""
