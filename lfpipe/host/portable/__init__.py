"""The modules of `lfpipe.host` for all systems, using only what Windows, macOS and Linux have in common."""
