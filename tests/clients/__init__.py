"""Clients that others wrote, in front of the emulators: README.md."""
