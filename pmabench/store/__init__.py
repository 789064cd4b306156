"""Run folders: samples written to disk during the run, events, manifest, catalogue; import of other files."""
