"""The face engines by their names in the configuration."""

from lfpipe.config import Track
from lfpipe.plugins import ENGINES, load
from lfpipe.track.engine import Engine


def make_engine(track: Track, portable: bool = False) -> Engine:
    """Returns the engine that track names, ready. Its libraries are imported only now.

    portable: see `LitertEngine`; MediaPipe's graph contains its own OpenCV.
    Raises UserError if its libraries or models are missing or have another version.
    """
    if track.engine == "mediapipe":
        from lfpipe.track.mediapipe_engine import MediapipeEngine

        return MediapipeEngine(track.refine)
    name: str = track.engine
    if name != "litert":
        engine: Engine = load(ENGINES, name)(track)
        return engine
    from lfpipe.track.litert_engine import LitertEngine

    return LitertEngine(track.refine, portable)
