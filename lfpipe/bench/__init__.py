"""Error against run time: cost and gain of each choice on this machine, this scene and this sequence.

A subject (`tracker.py`, `filters.py`, ...) is a function from inputs to candidates. A candidate is one point of a diagram.
`runner` measures candidates in turns, `results` stores every sample, `diagrams` and `report` present them, `comparison` and
`builds` report differences beyond noise.
"""
