"""Words: `names` (kinds of test, coefficients), `method_words`."""
