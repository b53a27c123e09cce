"""MediaPipe's own graph behind the same protocol."""

import sys
import types
from collections.abc import Callable, Iterator

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.errors import UserError
from lfpipe.track.engine import Engine
from lfpipe.track.engines import make_engine
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


def test_takes_grey_and_deep_pictures(engine: Engine, placed: Placed) -> None:
    colour = placed((320, 200, 0.8))
    for picture in (cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY), colour.astype(np.uint16) * 257):
        engine.reset()
        assert engine.detect(picture) is not None  # type: ignore[arg-type]


@pytest.mark.parametrize("size", [(320, 240), (3840, 2160)])
def test_every_size_of_frame(engine: Engine, placed: Placed, size: tuple[int, int]) -> None:
    factor = size[1] / 480
    engine.reset()
    face = engine.detect(placed((0.5 * size[0], 0.42 * size[1], 0.7 * factor), size=size))
    assert face is not None
    assert np.hypot(*(face.eyes_px[0] - face.eyes_px[1])) == pytest.approx(89 * 0.7 * factor, rel=0.08)


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (1, 480), (640, 1)])
def test_tiny_pictures_hold_no_face(engine: Engine, size: tuple[int, int]) -> None:
    engine.reset()
    assert engine.detect(np.full((*size, 3), 128, np.uint8)) is None


@pytest.mark.parametrize(("shape", "kind"), [((0, 5, 3), np.uint8), ((9, 9, 2), np.uint8), ((9, 9, 3), np.float32)])
def test_other_arrays_are_refused_by_name(engine: Engine, shape: tuple[int, ...], kind: type) -> None:
    with pytest.raises(UserError, match=r"shape \("):
        engine.detect(np.zeros(shape, kind))


def test_version_without_facemesh_says_which_one_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    newer = types.ModuleType("mediapipe")
    newer.__version__ = "0.10.35"  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "mediapipe", newer)
    with pytest.raises(UserError, match=r"no FaceMesh.*\n.*0\.10\.21"):
        MediapipeEngine()
