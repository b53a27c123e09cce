"""Error against run time: what each choice costs and buys, on this machine, this scene, this sequence.

A subject (`tracker.py`, `filters.py`, ...) is a plain function from inputs to candidates; a candidate is one point of a diagram
that can be measured and timed by itself. `runner` measures candidates in turns, `results` keeps every sample, `diagrams` and
`report` draw them, `compare` and `builds` say what differs beyond noise.
"""
