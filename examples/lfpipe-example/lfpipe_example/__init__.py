"""Parts for lfpipe, found by their entry points."""
