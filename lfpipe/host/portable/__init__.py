"""The modules of `lfpipe.host` by what Windows, macOS and Linux have in common; see there."""
