"""The engines on a real face: the landmark network in-thread and its parts, and MediaPipe's own
graph.
"""

import subprocess
import sys
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from lfpipe.config import Track
from lfpipe.track.engine import Engine, Face, make_engine
from lfpipe.track.litert_engine import PORTRAIT_PICTURES, LitertEngine, Liveness
from lfpipe.track.network import (
    Detection,
    FaceSelector,
    Roi,
    portable_warp,
    warp,
)
from tests.track.people import needs_mediapipe

Picture = NDArray[np.uint8]
Placed = Callable[..., Picture]


@pytest.fixture(scope="module")
def engine() -> LitertEngine:
    return LitertEngine()


@pytest.fixture(autouse=True)
def fresh(engine: LitertEngine) -> None:
    engine.reset()


def found(engine: Engine, picture: Picture) -> Face:
    face = engine.detect(picture)
    assert face is not None
    return face


def eye_distance(eyes_px: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(eyes_px[0] - eyes_px[1]))


def test_eyes_are_found_where_they_are_and_left_is_at_larger_x(
    engine: LitertEngine, placed: Placed
) -> None:
    assert engine.detect(placed()) is None
    face = found(engine, placed((320, 200, 0.8)))
    assert np.abs(face.eyes_px.mean(axis=0) - (320, 200)).max() < 6
    assert face.eyes_px[0, 0] > face.eyes_px[1, 0] + 50
    assert 0.9 < face.confidence <= 1.0
    x0, y0, x1, y1 = face.box_px
    assert (
        x0 < face.eyes_px[1, 0] < face.eyes_px[0, 0] < x1
        and y0 < face.eyes_px[:, 1].min()
        and y1 > 250
    )
    assert [engine.detect(placed()), engine.detect(placed())] == [None, None], "lost"
    assert engine.detect(placed((300, 200, 0.8))) is not None


def test_a_passer_by_does_not_steal_the_view_and_recentre_chooses_anew(
    engine: LitertEngine, placed: Placed
) -> None:
    viewer = (160.0, 200.0, 0.45)
    engine.detect(placed(viewer))
    for x in (620, 560, 500, 450):
        # larger, and nearer to the centre
        face = found(engine, placed(viewer, (x, 200, 0.7)))
        assert abs(face.eyes_px[:, 0].mean() - 160) < 15
    engine.reset()
    face = found(engine, placed(viewer, (450, 200, 0.7)))
    assert abs(face.eyes_px[:, 0].mean() - 450) < 20


def test_a_nearer_face_takes_over_after_a_second_of_scans_without_a_gap() -> None:
    """A passer-by is nearer for less than a second: 4 scans, a third of a second each."""
    viewer, passer_by = (100.0, 150.0, 180.0, 250.0), (300.0, 100.0, 460.0, 300.0)
    faces = [Detection(box, np.zeros((6, 2)), 0.9) for box in (viewer, passer_by)]
    selector = FaceSelector()
    selector.follow(viewer)
    for seen in (faces, faces, faces, faces[:1], faces, faces, faces):
        assert selector.rival(seen, viewer, 640, 480) is None
    assert selector.rival(faces, viewer, 640, 480) is faces[1]


@pytest.mark.parametrize("size", [(320, 240), (1920, 1080), (3840, 2160)])
def test_every_size_of_frame(engine: LitertEngine, placed: Placed, size: tuple[int, int]) -> None:
    factor = size[1] / 480
    assert engine.detect(np.full((1, size[0] // 320, 3), 128, np.uint8)) is None, (
        "tiny pictures hold no face"
    )
    face = found(engine, placed((0.5 * size[0], 0.42 * size[1], 0.7 * factor), size=size))
    assert eye_distance(face.eyes_px) == pytest.approx(89 * 0.7 * factor, rel=0.08)


def test_mediapipe_is_never_imported() -> None:
    """Its import takes longer than everything else of a start."""
    code = (
        "import sys; from lfpipe.config import Track; from lfpipe.track.engine import"
        " make_engine;make_engine(Track()); print([m for m in ('mediapipe', 'matplotlib', 'scipy',"
        " 'jax') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert done.stderr == ""


@needs_mediapipe
def test_mediapipes_own_graph_finds_loses_and_finds_the_eyes(
    placed: Placed, capfd: pytest.CaptureFixture[str]
) -> None:
    graph = make_engine(Track(engine="mediapipe"))
    face = found(graph, placed((300, 210, 0.8)))
    assert np.abs(face.eyes_px.mean(axis=0) - (300, 210)).max() < 6
    assert face.eyes_px[0, 0] > face.eyes_px[1, 0] + 50
    graph.reset()
    assert graph.detect(placed()) is None
    assert graph.detect(np.zeros((1, 1, 3), np.uint8)) is None
    assert graph.detect(placed((200, 210, 0.8))) is not None
    graph.close()
    # it would log at the start, at the first picture and at the first face
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "roi", [Roi(51.3, 40.2, 60.0, 0.1), Roi(5.0, 3.0, 40.0, -0.4), Roi(90.0, 70.0, 31.0, 3.0)]
)
def test_the_portable_warp_differs_by_a_rounding_only(roi: Roi) -> None:
    """Places of 1/32 px: half of one off, along and down, in a picture whose pixels change by at
    most that much.
    """
    y, x = np.mgrid[0:80, 0:100]
    image = np.stack([2 * x, 3 * y, x + y], axis=2).astype(np.uint8)
    exact, rounded = (
        roi.crop(image, roi.matrix(64), 64, cv2.BORDER_REPLICATE, way).astype(int)
        for way in (warp, portable_warp)
    )
    assert np.abs(exact - rounded).max() <= 1 and rounded.std() > 5


def test_a_viewer_who_covers_half_of_a_portrait_is_not_taken_for_it() -> None:
    """The detector finds a portrait a little beside its last place; a viewer stands further off."""
    liveness = Liveness()
    eyes_px = np.array([[330.0, 200.0], [270.0, 200.0]])
    box_px = (240.0, 140.0, 360.0, 260.0)
    for _ in range(2 * PORTRAIT_PICTURES):
        liveness.follow(Face(eyes_px, 1.0, box_px=box_px, eye_distance_px=60))
    liveness.scanned(box_px)
    taken = [
        liveness.is_portrait(
            Detection((240.0 + off, 140.0, 360.0 + off, 260.0), np.zeros((6, 2)), 1.0)
        )
        for off in (0, 6, 12, 36, 48, 60)
    ]
    assert taken == [True, True, True, False, False, False]
