"""Run folders: samples on disk while they are taken, events, manifest, catalogue, and other programs' files."""
