"""The choice of a face engine by its name in the configuration."""

from types import NoneType
from typing import Any

from lfpipe.config import Track
from lfpipe.eyes import HEAD_POINTS
from lfpipe.plugins import ENGINES, array, conform, make
from lfpipe.track.engine import Engine, Face


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

        return MediapipeEngine(track.refine)
    results = {"detect": _face, "examine": NoneType, "reset": NoneType, "close": NoneType}
    engine: Engine = make(ENGINES, name, results, track)
    return engine


def _face(result: Any) -> Face | None:
    """For `plugins.conform`."""
    face: Face | None = conform(result, Face | None)
    if face is not None:
        array(2, 2)(face.eyes_px)
        if face.head_px is not None:
            array(len(HEAD_POINTS), 3)(face.head_px)
    return face
