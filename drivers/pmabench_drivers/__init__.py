"""Drivers of pmabench: one module or package per device family; found by entry point, never imported by name."""
