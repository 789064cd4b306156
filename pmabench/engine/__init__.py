"""Executes plans: acquisition, watch on measured limits, searches and loops, operator prompts."""
