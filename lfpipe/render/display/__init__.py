"""Colours of what lies over the picture, RGB; splash.py has them without importing a display."""

TEXT = (255, 255, 255)
SECOND = (180, 190, 201)
OFF = (124, 132, 142)
ACCENT = (53, 196, 215)
RED = (255, 90, 90)
BACK = (18, 21, 26)
