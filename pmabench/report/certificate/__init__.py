"""The first two pages of a report: what was found, how well, where it holds, and why it can be believed.

- `sheet`: everything on the two pages, put together
- page 1: `result_table`, `report.figures`, `force_chart`
- page 2: a stroke, in `force_chart`; `quality`: coverage of the sweep, sources of uncertainty, checks, findings;
  and for page 1 what the results do not hold for
- `interactive`: the data and the script that draw the charts anew in a browser
"""
