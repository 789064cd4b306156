"""Components of figures: drawings from plain columns, their words, units and numbers; no kind of test, no page.

- `pictures`: a drawing with title, caption, alternative text and its numbers (a `Frame` of text); `svg`: as an element
  of a page
- drawings: `plots`, `time_plots`; `chart`: as data, for static SVG and for a script
- `web`: files for pages in a browser (uPlot, the font Inter), unchanged, with their licences
- figures that several kinds of test share: `motion`
- words, display units, numbers and tables of text: `wording`
"""
