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
from lfpipe.track.detector import (
    SAME_OVERLAP,
    Detection,
    FaceSelector,
    overlap,
    suppressed,
)
from lfpipe.track.engine import Engine, Face, make_engine
from lfpipe.track.litert_engine import LitertEngine
from lfpipe.track.liveness import PORTRAIT_PICTURES, STILL_PICTURES, Liveness
from lfpipe.track.mediapipe_engine import MediapipeEngine
from lfpipe.track.network import Roi, mapped, portable_warp, warp
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


@needs_mediapipe
def test_same_eyes_as_facemesh_on_a_moving_face(engine: LitertEngine, placed: Placed) -> None:
    mesh = MediapipeEngine()
    errors = []
    try:
        for i in range(12):
            picture = placed((250 + 9 * i, 200 + 3 * i, 0.6 + 0.02 * i))
            errors.append(found(engine, picture).eyes_px - found(mesh, picture).eyes_px)
    finally:
        mesh.close()
    eye_distance_px = 0.7 * 89
    # ours rest on corners and lower lid, theirs on both lids
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02 * eye_distance_px
    assert (
        float(np.sqrt(np.square(errors - np.mean(errors, axis=0)).sum(axis=-1).mean()))
        < 0.005 * eye_distance_px
    )


def test_subpixel_moves_are_followed(engine: LitertEngine, placed: Placed) -> None:
    """A face moved by a tenth of a pixel is seen to move by that: nothing in the crop or the region
    rounds.
    """
    found = []
    for i in range(31):
        for _ in range(2 if i else 8):  # the region of interest settles
            # as a lens does
            blurred = cv2.GaussianBlur(placed((320 + i / 10, 200, 0.7)), (0, 0), 0.8)
            face = engine.detect(np.asarray(blurred, np.uint8))
        assert face is not None
        found.append(face.eyes_px[:, 0].mean())
    residual = np.array(found) - np.polyval(np.polyfit(np.arange(31), found, 1), np.arange(31))
    assert np.polyfit(np.arange(31) / 10, found, 1)[0] == pytest.approx(1.0, abs=0.1)
    assert residual.std() < 0.15  # whole pixels would leave 0.29


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


def test_overlap_is_intersection_over_union() -> None:
    a = (0.0, 0.0, 2.0, 2.0)
    others = [
        (0.0, 0.0, 2.0, 2.0),
        (1.0, 0.0, 3.0, 2.0),
        (2.0, 2.0, 3.0, 3.0),
        (0.5, 0.5, 0.5, 0.5),
    ]
    assert [overlap(a, other) for other in others] == pytest.approx([1, 1 / 3, 0, 0])
    assert overlap(others[3], others[3]) == 0  # no area, no overlap, no division by zero
    here = (100.0, 100.0, 200.0, 200.0)
    faces = (130.0, 110.0, 230.0, 210.0), (180.0, 100.0, 280.0, 200.0), (140.0, 140.0, 160.0, 160.0)
    assert [overlap(here, face) > SAME_OVERLAP for face in faces] == [
        True,
        False,
        False,
    ], "the same where it was and of its size"


def test_suppression_averages_by_score_and_keeps_the_best_score() -> None:
    rows = np.array(
        [[0, 0, 10, 10, 1.0], [1, 0, 11, 10, 4.0], [50, 50, 60, 60, 7.0], [3, 3, 3, 3, 9.0]]
    )
    out = suppressed(rows, np.array([0.6, 0.9, 0.7, 0.5]))
    assert [score for _, score in out] == [0.9, 0.7, 0.5]
    np.testing.assert_allclose(out[0][0], (0.6 * rows[0] + 0.9 * rows[1]) / 1.5)
    np.testing.assert_allclose(out[2][0], rows[3])


@pytest.mark.parametrize("angle", [0.0, 0.5, -1.3, 3.0])
def test_crop_shows_what_the_map_says(angle: float) -> None:
    image = np.zeros((100, 100, 3), np.uint8)
    image[40:44, 60:64] = 255
    roi = Roi(62.0, 42.0, 20.0, angle)
    crop = roi.crop(image, roi.matrix(60), 60, 0)[..., 0].astype(float)
    y, x = np.indices(crop.shape)
    middle = np.array([[(crop * x).sum() / crop.sum(), (crop * y).sum() / crop.sum()]])
    np.testing.assert_allclose(mapped(middle, roi.matrix(60))[0], (61.5, 41.5), atol=0.1)


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


@pytest.mark.parametrize(
    ("carried", "pictures"), [(False, PORTRAIT_PICTURES), (True, STILL_PICTURES)]
)
def test_a_portrait_that_was_carried_in_counts_as_one_later(carried: bool, pictures: int) -> None:
    """A viewer who has moved may sit still."""
    liveness = Liveness()

    def follow(x: float) -> bool:
        eyes_px = np.array([[x + 30, 200.0], [x - 30, 200.0]])
        liveness.follow(
            Face(eyes_px, 1.0, box_px=(x - 60, 140.0, x + 60, 260.0), eye_distance_px=60)
        )
        return liveness.still

    for frame in range(40):
        follow(200.0 + 5 * frame * carried)
    rests = [follow(395.0 if carried else 200.0) for _ in range(2 * pictures)]
    assert rests.index(True) == pytest.approx(pictures, abs=60)


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
