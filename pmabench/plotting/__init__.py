"""What figures are made of: drawings from plain columns, their words, units and numbers; no kind of test, no page.

- `pictures`: a drawing with title, caption, alternative text and its numbers; `svg`: as an element of a page
- drawings: `plots`, `time_plots`, `ramp_plots`, `motion_plots`
- figures that several kinds of test share: `loops`, `isometric`, `motion`
- words and units: `wording`; numbers as people read them: `rounding`
"""
