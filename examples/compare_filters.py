"""Replays a recording with two filters and compares their errors.

Usage: python compare_filters.py SEQ SCENE
"""

import sys

import lfpipe

if len(sys.argv) != 3:
    sys.exit(__doc__)

for name in ("predictive", "mean"):
    report = lfpipe.replay(sys.argv[1], sys.argv[2], settings={"track.filter": name})
    print(
        name,
        report["counts"]["faces"],
        "faces",
        report["truth_error"] or "no truth",
        report["digests"]["eyes"][:12],
    )
