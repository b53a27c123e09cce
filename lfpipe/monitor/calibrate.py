"""Measures an object of known size in the camera's picture.

A window guides the user if there is a screen.
"""

import math
from collections import deque
from collections.abc import Collection
from contextlib import closing

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.live_source import live_camera
from lfpipe.capture.open_source import open_source
from lfpipe.config import Config, LiveSource, Placement
from lfpipe.errors import UserError
from lfpipe.live.alignment import FAST_FRAMES
from lfpipe.live.estimator import Estimator
from lfpipe.live.records import pairs_in_need
from lfpipe.monitor.camera_window import ACCEPT, CANCEL, CameraWindow, Distance, crossed, mirrored
from lfpipe.render.display.open_display import has_display
from lfpipe.render.display.overlay import Event, Item, Overlay
from lfpipe.track.engine import Face
from lfpipe.track.make_engine import make_engine

MEASURED_FRAMES = 45  # with a face: one and a half seconds
SPREAD = 0.05  # limit of the interquartile range as a share of the median: the viewer moved
PATIENCE_FRAMES = 600  # without a still face before giving up: 20 s at 30 Hz
CHECK_MM = 200  # between the two distances: enough to tell an error of a few percent
AGAIN = Item("Again", Event("previous"), "PgUp")
ACCEPTS, CANCELS = {"enter", "freeze"}, {"quit", "close"}  # events
EDGES = (
    "Click the middle of one short edge.",
    "First edge marked. Click the middle of the other short edge.",
)
CANCELLED = UserError("nothing was measured", "start again when you are ready")
NOBODY = UserError(
    "no face was detected",
    "sit in good light and look into the camera; `lfpipe up --demo --camera SRC` shows its picture",
)
RESTLESS = UserError(
    "the eyes did not stay still long enough", "rest your head, keep the distance, and try again"
)


def placement_of(live: LiveSource, config: Config) -> Placement:
    """How the second one of two cameras stands against the first, by what both see.

    Raises UserError if they see too little.
    """
    estimator = Estimator(attrs.evolve(live, placement=None), aligns=True)
    assert estimator.alignment is not None
    width_px, height_px = live.frame_px
    frame: NDArray[np.uint8] = np.empty((height_px, width_px, 3), np.uint8)
    pair = pairs_in_need(live, [(0.0, 0.5)])
    with closing(open_source(live.source, live_camera(config, live.frame_px))) as source:
        for _ in range(PATIENCE_FRAMES):
            if source.read(frame) is None:
                break
            estimator.estimate(frame, pair)
            if estimator.alignment.frames >= FAST_FRAMES:
                return estimator.alignment.placement(estimator.swapped)
    raise UserError(
        f"{live.source}: too little is seen in both views",
        "point the cameras at something with texture, in good light",
    )


@attrs.frozen(kw_only=True)
class Measured:
    """What was measured."""

    size_px: float
    """The size of the object in px of a frame of config's size."""
    distance_mm: float
    """Its distance from the camera."""
    check_mm: tuple[float, float] | None = None
    """A second distance, and the one that the first measurement gives for it."""


def median_of(eye_distance_px: Collection[float]) -> tuple[float, bool]:
    """The median of distances (0 if there are none), and whether the viewer was still enough."""
    low, median, high = np.percentile(list(eye_distance_px) or [0.0], (25, 50, 75)).tolist()
    return median, high - low <= SPREAD * median > 0


def eyes_page(
    distance: Distance, ready: bool, has_face: bool, off_mm: float | None = None
) -> Overlay:
    """The page over the eyes. off_mm: by how much the distance that is checked is off; None: it is
    still to be measured.
    """
    checks = off_mm is not None
    task = (
        "Sit farther or nearer now, and set that distance."
        if checks
        else "Look into the camera; set how far it is away."
    )
    state = "Hold still until the ring is full." if has_face else "No face: sit in good light."
    if ready and off_mm is not None:
        state = f"Measured {distance.mm + off_mm:.0f} mm, off by {off_mm:+.0f} mm."
    elif ready:
        state = "Measured. Accept it."
    # each keeps its place, so a double click on Accept does not hit another one
    ends = (
        attrs.evolve(ACCEPT, off=not ready),
        attrs.evolve(AGAIN, off=not checks),
        attrs.evolve(CANCEL, label="Skip") if checks else CANCEL,
    )
    return Overlay(lines=(task, state), items=(*distance.items, *ends), types=True)


class _EyesMeasurement:
    """Eye distances in px while the head is still."""

    def __init__(self) -> None:
        self.px: deque[float] = deque(maxlen=MEASURED_FRAMES)
        self.restless = 0  # frames since the ring was full
        self.has_face = self.seen = False

    def add(self, face: Face | None) -> None:
        self.has_face = face is not None
        if face is not None:
            self.seen = True
            self.px.append(math.dist(*face.eyes_px.tolist()))
            if not median_of(self.px)[1]:
                self.px.clear()
        self.restless = 0 if self.share == 1.0 else self.restless + 1

    @property
    def share(self) -> float:
        """How far the ring is full."""
        return len(self.px) / MEASURED_FRAMES

    @property
    def median_px(self) -> float:
        return median_of(self.px)[0]


def by_eyes(config: Config, camera: str | None, distance_mm: float) -> Measured:
    """The viewer's eye distance; median over several frames. In a window, the viewer sets the
    distance, accepts, and may check the result at a second one.

    Raises UserError if no face is detected, the face does not stay still, the source ends, or the
    user cancels.
    """
    distance = Distance(f"{distance_mm:g}")
    eyes = _EyesMeasurement()
    accepted: Measured | None = None
    with (
        closing(CameraWindow(config, camera)) as camera_window,
        closing(make_engine(config.track)) as engine,
    ):
        while True:
            if not camera_window.read() or (
                camera_window.window is None and eyes.restless > PATIENCE_FRAMES
            ):
                if accepted is not None:
                    return accepted
                raise RESTLESS if eyes.seen else NOBODY
            face = engine.detect(camera_window.picture)
            eyes.add(face)
            ready = eyes.share == 1.0 and distance.is_possible
            now = Measured(size_px=eyes.median_px, distance_mm=distance.mm)
            if ready and camera_window.window is None:
                return now
            off_mm = None
            if accepted is not None:
                measured_mm = accepted.distance_mm * accepted.size_px / max(eyes.median_px, 1.0)
                off_mm = measured_mm - distance.mm
            places_px = [] if face is None else face.eyes_px.tolist()
            for event in camera_window.show(
                eyes_page(distance, ready, eyes.has_face, off_mm),
                mirrored(camera_window.picture, places_px, eyes.share),
            ):
                distance.take(event)
                if event.name in CANCELS:
                    if accepted is None:
                        raise CANCELLED
                    return accepted
                if event.name in ACCEPTS and ready:
                    if accepted is not None and off_mm is not None:
                        check_mm = distance.mm, distance.mm + off_mm
                        return attrs.evolve(accepted, check_mm=check_mm)
                    accepted = now
                    distance.set(distance.mm + CHECK_MM)
                    eyes = _EyesMeasurement()
                    break
                if event == AGAIN.event and accepted is not None:
                    distance.set(accepted.distance_mm)
                    accepted = None
                    eyes = _EyesMeasurement()
                    break


def by_card(config: Config, camera: str | None, distance_mm: float) -> Measured:
    """Width of the card, from two clicks on a frozen frame.

    Raises UserError without a screen, if the source ends before a frame is frozen, or if the user
    cancels.
    """
    if not has_display():
        raise UserError(
            "--by card needs a screen for a window to click in",
            "run it on a desktop, or use --by eyes",
        )
    distance = Distance(f"{distance_mm:g}")
    clicks = list[tuple[float, float]]()
    card_px = 0.0
    frozen = False
    with closing(CameraWindow(config, camera)) as camera_window:
        while True:
            if not frozen and not camera_window.read():
                raise UserError(
                    "the source ended before Enter was pressed",
                    "use a longer recording, ?loop=1, or a camera",
                )
            if not frozen:
                freeze = attrs.evolve(ACCEPT, label="Freeze", off=not distance.is_possible)
                page = Overlay(
                    lines=("Set the distance of the card from the camera, and hold it there.",),
                    items=(*distance.items, freeze, CANCEL),
                    types=True,
                )
            else:
                state = f"{card_px:.1f} px wide. Accept it, or click to start again."
                page = Overlay(
                    lines=(state if card_px else EDGES[len(clicks) % 2],),
                    items=(attrs.evolve(ACCEPT, off=not card_px), CANCEL),
                )
            for event in camera_window.show(page, crossed(camera_window.picture, clicks)):
                if event.name in CANCELS:
                    raise CANCELLED
                if event.name in ACCEPTS and card_px:
                    return Measured(size_px=card_px, distance_mm=distance.mm)
                if not frozen:
                    distance.take(event)
                    frozen = event.name in ACCEPTS and distance.is_possible
                elif event.at_px is not None:
                    del clicks[: 2 * (len(clicks) == 2)]  # a third click starts again
                    clicks.append(event.at_px)
                    card_px = math.dist(*clicks) if len(clicks) == 2 else 0.0
