"""lfpipe: a light field you look into, on an ordinary screen."""

__version__ = "0.1.0"
