"""A library model fitted to a table (`model fit`): `model_fit`, made of `model_problem`, `identifiability`."""
