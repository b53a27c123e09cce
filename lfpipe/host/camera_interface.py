"""Which modules of `lfpipe.capture` list and read cameras here: those of Video4Linux."""

LIST, SOURCE = "camera_list", "camera"
