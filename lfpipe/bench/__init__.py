"""Error against run time: cost and gain of each choice for this machine, scene and sequence."""
