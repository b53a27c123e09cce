"""Measures an object of known size in the camera's picture.

A window guides the user if there is a screen.
"""

import math
from collections import deque
from collections.abc import Collection, Sequence
from contextlib import closing

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.live_source import live_camera
from lfpipe.capture.open_source import camera_settings, open_source
from lfpipe.config import Config, LiveSource, Placement
from lfpipe.errors import UserError
from lfpipe.live.alignment import FAST_FRAMES
from lfpipe.live.estimator import Estimator
from lfpipe.live.records import pairs_in_need
from lfpipe.render.display.open_display import has_display
from lfpipe.render.display.overlay import Event, Item, Overlay
from lfpipe.track.make_engine import make_engine

MEASURED_FRAMES = 45  # with a face: one and a half seconds
SPREAD = 0.05  # limit of the interquartile range as a share of the median: the viewer moved
PATIENCE_FRAMES = 600  # without a still face before giving up: 20 s at 30 Hz
RING = 1.6  # radius over the distance of the eyes: around the face
GREY, ACCENT = (110, 110, 110), (215, 196, 53)  # BGR
ACCEPT = Item("Accept", Event("enter"), "Enter")
CANCEL = Item("Cancel", Event("close"), "Esc")
EDGES = (
    "Click the middle of one short edge.",
    "First edge marked. Click the middle of the other short edge.",
)
AGAIN = UserError("nothing was measured", "start again when you are ready")
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


class _CameraWindow:
    """The camera and, if there is a screen, a window with its picture and lines of text.

    clicks: px of the picture.
    """

    def __init__(self, config: Config, camera: str | None) -> None:
        width_px, height_px = config.camera.frame_px
        self.picture: NDArray[np.uint8] = np.empty((height_px, width_px, 3), np.uint8)
        self.clicks: list[tuple[float, float]] = []
        self.source = open_source(camera or config.camera.source, camera_settings(config))
        self.window = None
        if has_display():
            from lfpipe.render.display.window import ScreenWindow
            from lfpipe.render.ui.overlay_view import OverlayView

            # large, for sub-pixel clicks
            self.window = ScreenWindow(
                (2 * width_px, 2 * height_px), "lfpipe calibrate", OverlayView()
            )

    def read(self) -> bool:
        """Reads the next picture. False at the end of the source."""
        return self.source.read(self.picture) is not None

    def show(
        self,
        marks: Sequence[Sequence[float]],
        *lines: str,
        mirrored: bool = False,
        still: float = 0.0,
        items: tuple[Item, ...] = (),
    ) -> bool:
        """Shows the picture with crosses at marks, and around them a ring of which the share
        `still` is full. Returns whether Enter was pressed, or the item that does the same; True
        without a window. Raises UserError if the user cancels.
        """
        if self.window is None:
            return True
        marked = self.picture.copy()
        if mirrored:
            marked = np.ascontiguousarray(marked[:, ::-1])
            marks = [(marked.shape[1] - 1 - x, y) for x, y in marks]
        if still:
            middle = np.mean(marks, axis=0)
            radius_px = round(RING * math.dist(*marks))
            for share, colour in ((1.0, GREY), (still, ACCENT)):
                place = (round(middle[0]), round(middle[1])), (radius_px, radius_px)
                end_deg = 360 * share - 90
                cv2.ellipse(marked, *place, 0, -90, end_deg, colour, 4, cv2.LINE_AA)
        for x, y in marks:
            # visible on a face and on a white card
            for colour, thick_px in (((0, 0, 0), 5), ((255, 255, 255), 2)):
                cv2.drawMarker(marked, (round(x), round(y)), colour, cv2.MARKER_CROSS, 21, thick_px)
        self.window.overlay(Overlay(lines=lines, items=items))
        self.window.show(marked)
        events = self.window.events()
        names = {event.name for event in events}
        if names & {"quit", "close"}:
            raise AGAIN
        self.clicks += [event.at_px for event in events if event.at_px is not None]
        return bool(names & {"enter", "freeze"})

    def close(self) -> None:
        self.source.close()
        if self.window is not None:
            self.window.close()


def median_of(eye_distance_px: Collection[float]) -> tuple[float, bool]:
    """The median of distances (0 if there are none), and whether the viewer was still enough."""
    low, median, high = np.percentile(list(eye_distance_px) or [0.0], (25, 50, 75)).tolist()
    return median, high - low <= SPREAD * median > 0


def by_eyes(config: Config, camera: str | None, distance_mm: float) -> float:
    """The viewer's eye distance in px of a frame of config's size; median over several frames.

    Raises UserError if no face is detected, the face does not stay still, the source ends, or the
    user cancels.
    """
    eye_distance_px: deque[float] = deque(maxlen=MEASURED_FRAMES)
    median_px = 0.0
    still = False
    missed = 0
    accepted = False
    with (
        closing(_CameraWindow(config, camera)) as camera_window,
        closing(make_engine(config.track)) as engine,
    ):
        while not (len(eye_distance_px) == MEASURED_FRAMES and still and accepted):
            if not camera_window.read() or missed > PATIENCE_FRAMES:
                raise RESTLESS if eye_distance_px else NOBODY
            face = engine.detect(camera_window.picture)
            if face is not None:
                eye_distance_px.append(math.dist(*face.eyes_px.tolist()))
            median_px, still = median_of(eye_distance_px)
            missed = missed + 1 if face is None or not still else 0
            state = f"eyes {median_px:.1f} px apart" if face is not None else "no face detected"
            share = len(eye_distance_px) / MEASURED_FRAMES if still and face is not None else 0.0
            accepted = camera_window.show(
                [] if face is None else face.eyes_px.tolist(),
                f"Eyes {distance_mm:g} mm from the camera. Look into it and hold still.",
                state,
                mirrored=True,
                still=share,
                items=(attrs.evolve(ACCEPT, off=share < 1), CANCEL),
            )
    return median_px


def by_card(config: Config, camera: str | None, distance_mm: float) -> float:
    """Width of the card in px of a frame of config's size, from two clicks on a frozen frame.

    Raises UserError without a screen, if the source ends before a frame is frozen, or if the user
    cancels.
    """
    if not has_display():
        raise UserError(
            "--by card needs a screen for a window to click in",
            "run it on a desktop, or use --by eyes",
        )
    with closing(_CameraWindow(config, camera)) as camera_window:
        frozen = False
        while not frozen:
            if not camera_window.read():
                raise UserError(
                    "the source ended before Enter was pressed",
                    "use a longer recording, ?loop=1, or a camera",
                )
            frozen = camera_window.show(
                (),
                f"Card {distance_mm:g} mm from the camera, facing it.",
                items=(attrs.evolve(ACCEPT, label="Freeze"), CANCEL),
            )
        clicks = camera_window.clicks
        clicks.clear()
        while True:
            del clicks[: 2 * (len(clicks) > 2)]  # a third click starts again
            card_px = math.dist(*clicks) if len(clicks) == 2 else 0.0
            state = (
                f"{card_px:.1f} px wide. Accept it, or click to start again."
                if card_px
                else EDGES[len(clicks)]
            )
            if (
                camera_window.show(
                    clicks, state, items=(attrs.evolve(ACCEPT, off=not card_px), CANCEL)
                )
                and card_px
            ):
                return card_px
