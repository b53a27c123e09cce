"""The page that measures the camera's focal length by the distance of the viewer's eyes (key k)."""

import math
from collections import deque
from collections.abc import Collection, Sequence
from functools import partial

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config.modes import CameraViewer
from lfpipe.config.modes import Viewer as ViewerKind
from lfpipe.config.user_files import check_focal, keep_focal
from lfpipe.eyes import EYES, EyesRecord
from lfpipe.render.display.display import Event, Item, Overlay
from lfpipe.render.presenter import Drawing, Presenter, draw_scene
from lfpipe.render.synthesis.compositor import Key
from lfpipe.render.ui.files import Files
from lfpipe.render.ui.pages import Page
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.context import Context
from lfpipe.transport.ring import Reader

NEAREST_CM, FARTHEST_CM, USUAL_MM = 10, 500, 600.0
SLIDER_CM = 30, 150  # usual seats
STEPS = {"alpha-": -1, "less": -1, "alpha+": 1, "more": 1}  # cm by event
MEASURED_FRAMES = 45  # with a face: one and a half seconds
SPREAD = 0.05  # limit of the interquartile range as a share of the median: the viewer moved
RING = 1.6  # radius over the distance of the eyes: around the face
BELOW = 0.4  # of the preview's height: the lines and buttons lie there
# BGR, the eyes as the lenses of most glasses
GREY, RED, ACCENT, BACK = (110, 110, 110), (90, 90, 255), (215, 196, 53), (26, 21, 18)
ACCEPT = Item("Accept", Event("enter"), main=True)
AGAIN = Item("Again", Event("previous"))
DONE = Item("Done", Event("close"), main=True)


@attrs.define
class Distance:
    """A distance to step or to slide."""

    cm: float

    def set(self, cm: float) -> None:
        self.cm = min(max(cm, NEAREST_CM), FARTHEST_CM)

    def take(self, event: Event) -> bool:
        """Follows an event; returns whether it is one of its own."""
        if event.name in STEPS:
            self.set(self.cm + STEPS[event.name])
        elif event.name == "distance":
            low, high = SLIDER_CM
            self.set(low + round(event.value * (high - low)))
        return event.name in (*STEPS, "distance")

    @property
    def items(self) -> tuple[Item, ...]:
        low, high = SLIDER_CM
        at = min(max((self.cm - low) / (high - low), 0.0), 1.0)
        return (
            Item("", Event("alpha-"), "-"),
            Item(f"{self.cm:g} cm", Event("distance"), slider=at),
            Item("", Event("alpha+"), "+"),
        )


def median_of(eye_distance_px: Collection[float]) -> tuple[float, bool]:
    """The median of distances (0 if there are none), and whether the viewer was still enough."""
    low, median, high = np.percentile(list(eye_distance_px) or [0.0], (25, 50, 75)).tolist()
    return median, high - low <= SPREAD * median > 0


class StillEyes:
    """Eye distances in px while the head is still."""

    def __init__(self) -> None:
        self._px: deque[float] = deque(maxlen=MEASURED_FRAMES)
        self.has_face = False

    def add(self, eye_distance_px: float | None) -> None:
        """Takes the distance in the next frame, None without a face."""
        self.has_face = eye_distance_px is not None
        if eye_distance_px is not None:
            self._px.append(eye_distance_px)
            if not median_of(self._px)[1]:
                self._px.clear()

    @property
    def share(self) -> float:
        """How much of the measurement is done."""
        return len(self._px) / MEASURED_FRAMES

    @property
    def median_px(self) -> float:
        return median_of(self._px)[0]


def mirrored(
    picture: NDArray[np.uint8], eyes_px: Sequence[Sequence[float]], still: float
) -> NDArray[np.uint8]:
    """A mirrored picture with the left and the right eye, and a ring around them of which the
    share `still` is full; without eyes, the picture alone.
    """
    drawn = np.ascontiguousarray(picture[:, ::-1])
    if not eyes_px:
        return drawn
    eyes = [(round(drawn.shape[1] - 1 - x), round(y)) for x, y in eyes_px]
    middle = np.mean(eyes, axis=0).round().astype(int).tolist()
    radius_px = round(RING * math.dist(*eyes))
    for share, colour in ((1.0, GREY), (still, ACCENT)):
        size = (radius_px, radius_px)
        cv2.ellipse(drawn, middle, size, 0, -90, 360 * share - 90, colour, 4, cv2.LINE_AA)
    for eye, colour in zip(eyes, (RED, ACCENT), strict=True):
        cv2.circle(drawn, eye, max(4, radius_px // 12), colour, 2, cv2.LINE_AA)
    return drawn


def calibration_page(distance: Distance, ready: bool, has_face: bool, is_stored: bool) -> Overlay:
    """The lines and buttons."""
    state = "Set your distance from the camera, then hold still"
    if not has_face:
        state = "No face: sit in good light"
    elif ready:
        state = "Saved. To check: move, set the new distance" if is_stored else "Ready"
    last = DONE if is_stored else attrs.evolve(ACCEPT, off=not ready)
    return Overlay(lines=(state,), items=(*distance.items, AGAIN, last))


def _save(viewer: ViewerKind, focal_px: float, width_px: int) -> None:
    """Stores the focal length of a viewer's camera. Raises UserError."""
    check_focal(focal_px, width_px)
    name = viewer.name if isinstance(viewer, CameraViewer) else ""
    keep_focal(name or viewer.source, focal_px, width_px)


class CalibrationPage(Page):
    """The camera's mirrored picture in place of the scene, and the distance to set. Accept asks to
    store the focal length.
    """

    def __init__(self, context: Context, presenter: Presenter, files: Files) -> None:
        super().__init__()
        self._context = context
        self._files = files
        self._presenter = presenter
        self.distance = Distance((context.options.calibrate_mm or USUAL_MM) / 10)
        self._is_stored = False
        self._eyes = StillEyes()
        self._rings = list[Reader]()
        self._record = np.zeros((), EYES)
        width_px, height_px = context.config.camera.frame_px
        self._frame: NDArray[np.uint8] = np.zeros((height_px, width_px, 3), np.uint8)

    def open(self) -> None:
        segment = self._context.spec.session.segment
        self._rings = [Reader(segment("frames")), Reader(segment("eyes"))]
        self._begin()
        self._presenter.draw_by(self._draw)

    def close(self) -> None:
        self._presenter.draw_by(draw_scene)
        while self._rings:
            self._rings.pop().close()

    def _begin(self) -> None:
        self._is_stored = False
        self._eyes = StillEyes()

    def stored(self) -> None:
        """Called when what was accepted is stored and applies."""
        self._is_stored = True

    @property
    def _is_ready(self) -> bool:
        return self._eyes.share == 1.0

    def take(self, event: Event) -> bool:
        if event == ACCEPT.event:
            if self._is_ready and not self._is_stored:
                eyes_mm = self._context.config.screen.eyes_mm
                focal_px = round(self._eyes.median_px * 10 * self.distance.cm / eyes_mm, 1)
                viewer, width_px = self._context.options.viewer, self._frame.shape[1]
                self._files.do(
                    partial(_save, viewer, focal_px, width_px),
                    lambda _: self._context.request("keep", focal_px=focal_px),
                )
        elif event == AGAIN.event:
            self._begin()
        elif self.distance.take(event):
            self._is_stored = False
        else:
            return False
        return True

    def overlay(self, t_ns: int) -> Overlay:
        frames, eyes = self._rings
        if frames.read(self._frame) is not None:
            self._presenter.redraw()
        if eyes.read(self._record) is not None:
            seen = EyesRecord.of(self._record)
            distance_px = seen.eye_distance_px or math.dist(seen.raw_px[:2], seen.raw_px[2:])
            self._eyes.add(distance_px if seen.face else None)
        return calibration_page(self.distance, self._is_ready, self._eyes.has_face, self._is_stored)

    def _draw(self, _viewer: Viewer, _key: Key) -> Drawing:
        eyes_px = self._record["raw_px"].tolist() if self._eyes.has_face else []
        drawn = mirrored(self._frame, eyes_px, self._eyes.share)
        below_px = round(BELOW * drawn.shape[0])
        edges = (0, below_px, 0, 0)
        framed = cv2.copyMakeBorder(drawn, *edges, cv2.BORDER_CONSTANT, value=BACK)
        return Drawing(np.asarray(framed, np.uint8), None)
