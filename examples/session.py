"""Starts a session, changes it and prints its latency: python session.py SCENE CAMERA."""

import sys

import lfpipe

with lfpipe.Session(sys.argv[1], camera=sys.argv[2], display="none") as session:
    session.set(**{"render.method": "nearest"})
    for number, _eyes in enumerate(session.stream()):
        if number == 30:
            break
    print(session.status()["end_to_end"])
