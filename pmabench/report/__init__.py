"""Tables, figures and the characterisation report; nothing here computes an estimate.

- `certificate`: the first two pages of a report; `foremost`: verdict, values and findings that come first, there and on
  a terminal, whose tables `terminal` prints
- `document`: what the report says, and as HTML, PDF and workbook; `templates` are its pages; `writing`: pages and
  files, and the last page of stored analyses, copied while nothing changed
- `figures`: every picture in it
- `pages`: other pages: bench card, comparison, history, a fitted model
- `cascade_record`, `cascade_drawing`, `cascade_page`: chains of muscles, drawn and animated
- `files`: analyses as files, for us and for other programs
- `publishing`: records, analyses and report as a package for a repository of research data
- `many`: reports over thousands of runs
- `words`: names of symbols, tests and methods; `bends`: the bend of a muscle, as its analysis wrote it down
"""
