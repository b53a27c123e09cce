"""The choice of a face engine by its name in the configuration."""

from lfpipe.config import Track
from lfpipe.plugins import ENGINES, make
from lfpipe.track.engine import Engine


def make_engine(track: Track, portable: bool = False) -> Engine:
    """The engine that track names, ready. Its libraries are imported only now. portable: see
    `LitertNetworks`.

    Raises UserError if its libraries or models are missing or have another version.
    """
    name: str = track.engine
    if name == "litert":
        from lfpipe.track.face_networks import LitertNetworks
        from lfpipe.track.litert_engine import LitertEngine

        return LitertEngine(LitertNetworks(portable))
    if name == "mediapipe":
        from lfpipe.track.mediapipe_engine import MediapipeEngine

        return MediapipeEngine()
    engine: Engine = make(ENGINES, name, track)
    return engine
