"""Components of figures: drawings from plain columns, their words, units and numbers; no kind of test, no page.

- `chart`: axes and curves as data, for static SVG and for a script
- `looks`: colours, shapes of marks; `svg`: symbols, paths and files of a drawing
- `pictures`: charts with title, caption, alternative text and their numbers (a `Frame` of text)
- `web`: files for pages (uPlot; Inter 3.19, cut to Latin, Greek and signs, for the PDF also Cyrillic and italics) with
  their licences, and `unknown-sign.ttf`, a box for what no font has
- figures that several kinds of test share: `motion`
- words, display units, numbers and tables of text: `wording`
"""
