"""A second simulated muscle, of other families than those that a fit may choose from; imports nothing of the project.

`muscle` is the muscle and its truth, `bench` the regulator and the noise, `hanging` the motion of a weight,
`campaign` contraction and relaxation with known causes, `driven` slow tests and motions at random. Nothing is shared
with the other judges of `tests.judge`: a fit that was made to suit those may fail here.
"""
