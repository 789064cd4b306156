"""Analyses as files: `csv_files`; for others: `export`, and models for simulators.

The models: `simulator_models`, `surface_model`.
"""
