"""Starts a session, changes it and prints its latency.

Usage: python session.py SCENE CAMERA
"""

import sys

import lfpipe

if len(sys.argv) != 3:
    sys.exit(__doc__)

with lfpipe.Session(sys.argv[1], camera=sys.argv[2], display="none") as session:
    session.set({"render.method": "nearest"})
    for number, _eyes in enumerate(session.stream()):
        if number == 30:
            break
    print(session.status()["end_to_end"])
