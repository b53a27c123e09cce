"""The face engines by their names in the configuration."""

from __future__ import annotations

from lfpipe.config import Track
from lfpipe.track.engine import Engine


def make_engine(track: Track, portable: bool = False) -> Engine:
    """The engine that track names, ready. Each imports its own libraries, and only when chosen.

    portable: see `LitertEngine`; MediaPipe's graph has an OpenCV of its own in it.
    Raises UserError where its libraries or models are missing or of another version.
    """
    if track.engine == "mediapipe":
        from lfpipe.track.mediapipe_engine import MediapipeEngine

        return MediapipeEngine(track.refine)
    from lfpipe.track.litert_engine import LitertEngine

    return LitertEngine(track.refine, portable)
