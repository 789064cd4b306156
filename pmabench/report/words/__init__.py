"""Words and numbers: `names` (coefficients), `wording` (kinds, points), `method_words`, `rounding`."""
