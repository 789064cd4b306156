"""Words and numbers: `wording` (symbols, kinds, points), `method_words`, `rounding`."""
