"""Analyses as files: `results` is the record of what was found, `folder` writes one and reads it back."""
