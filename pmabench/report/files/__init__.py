"""Analyses as files: `analysis_folder`, `csv_files`; for others: `export`, `latex`, `control_model`, `control_law`."""
