"""Shared by families of devices: options, polling, streaming, ramps in steps, serial lines. Standard library only."""
