"""Light fields as pictures and videos for other programs: quilt, side-by-side pair, wiggle,
sweep.
"""
