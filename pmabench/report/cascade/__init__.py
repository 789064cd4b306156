"""Chains of muscles: `cascade_page`, `cascade_drawing`, `cascade_figures`, `cascade_record`."""
