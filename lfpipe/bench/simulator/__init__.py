"""A simulator with ground truth: scenes drawn exactly from any viewpoint, viewers whose eyes are
known at every instant, a camera and a screen. Time is simulated: every run is bit-identical.

The product's own code runs in it, from the landmarks on: the choice of the face, `EyeTracker`, the
filter, `choose`, `Viewer`, `ScreenRefresh`, `Compositor` and the anaglyph. Only the networks, the
processes and the window are left out.
"""
