"""Error against run time: cost and gain of each choice on this machine, this scene and this
sequence.
"""
