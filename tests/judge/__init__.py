"""An independent simulator of contraction and relaxation tests with known faults; imports nothing of the project.

The results of the project are held against it (promise N5), so it shares no code, no table and no constant with it.
"""
