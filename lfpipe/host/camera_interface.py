"""The modules of `lfpipe.capture` that list and read cameras: those of Video4Linux."""

LIST, SOURCE = "camera_list", "camera"
