"""MediaPipe's own graph behind the same protocol."""

import sys
import types
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.errors import UserError
from lfpipe.track.engine import Engine, make_engine
from lfpipe.track.mediapipe_engine import MediapipeEngine

pytest.importorskip("mediapipe", reason="mediapipe has no wheel for this Python or machine")

Placed = Callable[..., NDArray[np.uint8]]


@pytest.fixture(scope="module")
def engine() -> Iterator[Engine]:
    one = make_engine(Track(engine="mediapipe"))
    yield one
    one.close()


def test_finds_loses_and_finds_the_eyes(engine: Engine, placed: Placed, capfd: pytest.CaptureFixture[str]) -> None:
    face = engine.detect(placed((300, 210, 0.8)))
    assert face is not None
    assert np.abs(face.eyes_px.mean(axis=0) - (300, 210)).max() < 6
    assert face.eyes_px[0, 0] > face.eyes_px[1, 0] + 50
    engine.reset()
    assert engine.detect(placed()) is None
    assert engine.detect(np.zeros((1, 1, 3), np.uint8)) is None
    assert engine.detect(placed((200, 210, 0.8))) is not None
    assert capfd.readouterr().err == ""  # its graph would log at the start, at the first picture and at the first face


def test_version_without_facemesh_says_which_one_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    newer = types.ModuleType("mediapipe")
    newer.__version__ = "0.10.35"  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "mediapipe", newer)
    with pytest.raises(UserError, match=r"no FaceMesh.*\n.*0\.10\.21"):
        MediapipeEngine()
