"""The public interface: promises of docs/python.md that its examples do not show."""

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import lfpipe
from lfpipe.eyes import EYES
from tests.support.processes import printed
from tests.support.refusal import refusal

HEAVY = ("numpy", "cv2", "zmq", "attrs", "lfpipe.cli", "lfpipe.config")


def test_import_lfpipe_loads_nothing_else() -> None:
    code = f"import sys, lfpipe; print([name for name in {HEAVY} if name in sys.modules])"
    assert printed(sys.executable, "-c", code) == "[]\n"


@pytest.fixture(scope="module")
def field(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> lfpipe.LightField:
    return lfpipe.open_scene(scene, {"scene.cache_dir": str(tmp_path_factory.mktemp("cache"))})


def test_render_view_gives_stored_views(field: lfpipe.LightField) -> None:
    for row in range(3):
        for col in range(3):
            picture = lfpipe.render_view(field, row, col, method="nearest")
            assert picture.shape == (48, 64, 3) and picture.dtype == np.uint8
            # blue first
            assert picture[0, 0].tolist() == [8 * row + 5, 8 * col + 5, 8 * (3 * row + col) + 5]


def test_render_anaglyph_for_two_eyes(field: lfpipe.LightField) -> None:
    anaglyph = lfpipe.render_anaglyph(
        field, (1, 0), (1, 2), mode="colour", settings={"render.method": "nearest"}
    )
    left, right = (lfpipe.render_view(field, 1, col, method="nearest") for col in (0, 2))
    np.testing.assert_array_equal(anaglyph, np.dstack((right[..., :2], left[..., 2])))
    again = lfpipe.render_anaglyph(
        field, (1, 1), (1, 2), mode="colour", settings={"render.method": "nearest"}
    )
    assert (anaglyph != again).any()  # each is an array of its own


CALLS: list[tuple[Callable[[Any], object], str]] = [
    (lambda field: lfpipe.render_view(field, 9, 0), "row 9"),
    (lambda field: lfpipe.render_view(field, float("nan"), 0), "row nan"),
    (lambda field: lfpipe.render_view(field, 0, 0, method="neerest"), "did you mean 'nearest'"),
    (lambda field: lfpipe.render_anaglyph(field, (0, 0), (0, 99)), "col 99"),
    (lambda field: lfpipe.render_view(field, 0, 0, frame=3), "frame 3"),
    (lambda field: lfpipe.render_view(field, 0, 0, frame=-1), "frame -1"),
    (lambda field: lfpipe.open_scene(np.zeros((3, 3))), "(3, 3)"),
    (
        lambda field: lfpipe.render_anaglyph(field, (0, 0), (0, 1), mode="dubai"),
        "did you mean 'dubois'",
    ),
    (lambda field: lfpipe.open_scene("/nowhere"), "/nowhere"),
    (lambda field: lfpipe.open_scene(np.full((3, 3, 48, 64, 3), -0.5)), "below 0, down to -0"),
    (lambda field: lfpipe.Tracker({"track.filtr": "mean"}), "track.filtr"),
    (lambda field: lfpipe.attach("nobody"), "nobody"),
]


@pytest.mark.parametrize(("call", "why"), CALLS)
def test_api_names_mistakes_with_a_remedy(
    field: lfpipe.LightField, call: Callable[[Any], object], why: str
) -> None:
    assert why in refusal(call, field).message


# take whatever a program may give them
SESSION: Any = lfpipe.Session
OPEN: Any = lfpipe.open_scene
REPLAY: Any = lfpipe.replay
VIEW: Any = lfpipe.render_view
ANAGLYPH: Any = lfpipe.render_anaglyph
VIEWS = np.zeros((1, 2, 8, 8, 3), np.uint8)
# a call with a wrong type -> the parameter, and the given type or the element that is wrong
WRONG: list[tuple[Callable[[Any], object], str, str]] = [
    (lambda _: SESSION(settings=3j), "settings", "complex"),
    (lambda _: SESSION(settings=np.zeros(3)), "settings", "ndarray"),
    (lambda _: SESSION(settings={1: 2}), "settings", "key int 1"),
    (lambda _: SESSION(camera=0), "camera", "int 0"),
    (lambda _: SESSION(trace=[]), "trace", "list"),
    (lambda _: SESSION(lambda: 0), "scene", "not function"),
    (lambda _: SESSION([[1], [1, 2]]), "scene", "must be an array"),
    (lambda _: SESSION(np.array([object()])), "scene", "not an array of object"),
    (lambda _: lfpipe.attach(5), "session", "int 5"),  # type: ignore[arg-type]
    (lambda _: lfpipe.Tracker("x"), "settings", "str"),  # type: ignore[arg-type]
    (lambda _: OPEN(VIEWS, invert_depth=1), "invert_depth", "int 1"),
    (lambda _: OPEN(VIEWS, disparity=lambda: 0), "disparity", "not function"),
    (lambda _: REPLAY(b"/x"), "sequence", "bytes"),
    (lambda _: REPLAY("/x", pace=30), "pace", "int 30"),
    (lambda _: VIEW("/p", 0, 0), "field", "str"),
    (lambda field: VIEW(field, "1", 0), "row", "str"),
    (lambda field: VIEW(field, 0, 0, frame=0.0), "frame", "float"),
    (lambda field: ANAGLYPH(field, ("a", 1), (0, 1)), "left", "str 'a'"),
    (lambda field: ANAGLYPH(field, (0, 0), (0, 0, 0)), "right", "(0, 0, 0)"),
]


@pytest.mark.parametrize(("call", "parameter", "given"), WRONG)
def test_api_names_the_parameter_of_a_wrong_type(
    field: lfpipe.LightField, call: Callable[[Any], object], parameter: str, given: str
) -> None:
    with pytest.raises(TypeError) as raised:
        call(field)
    assert re.search(rf"\b{parameter}\b", str(raised.value)) and given in str(raised.value)


def test_api_takes_numbers_of_numpy(field: lfpipe.LightField) -> None:
    shown = VIEW(field, np.float32(1), np.int64(2), frame=np.uint8(0))
    np.testing.assert_array_equal(shown, lfpipe.render_view(field, 1, 2))


@pytest.mark.parametrize(
    "frame",
    [None, np.zeros((48, 64), np.uint8), np.zeros((48, 64, 3)), np.zeros((0, 0, 3), np.uint8), "x"],
)
def test_tracker_refuses_what_is_no_picture(frame: object) -> None:
    with lfpipe.Tracker() as tracker:
        with pytest.raises(lfpipe.UserError, match="not a picture") as caught:
            tracker.update(frame)  # type: ignore[arg-type]
        assert caught.value.remedy
    assert "closed" in str(refusal(tracker.update, np.zeros((48, 64, 3), np.uint8)))
    tracker.close()


def test_tracker_finds_the_eyes_that_the_stage_finds(clip: Path) -> None:
    from lfpipe.config import Track
    from lfpipe.track.eye_tracker import EyeTracker

    video = cv2.VideoCapture(str(clip))
    stage = EyeTracker(Track())
    record = np.zeros((), EYES)
    with lfpipe.Tracker() as tracker:
        for number in range(12):
            frame = np.asarray(video.read()[1], np.uint8)
            t_ns = number * 33_333_333
            eyes = tracker.update(frame, t_ns)
            stage.update(stage.engine.detect(frame), t_ns)
            stage.write(record, frame)
            stage.engine.examine(frame)
            assert eyes is not None and eyes.head is not None
            np.testing.assert_array_equal(eyes.filtered_px, record["filtered_px"])
        assert eyes is not None and eyes.head is not None
        assert (
            eyes.filtered_px[0, 0] > eyes.filtered_px[1, 0] and 400 < eyes.head.position_mm[2] < 800
        )
        assert tracker.update(np.zeros_like(frame), 10**9) is None
    stage.engine.close()
