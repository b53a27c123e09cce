"""Measures an object of known size in the camera's picture: eyes in a terminal, a card in a window;
the page of a session's window is `lfpipe.render.ui.calibration`.
"""

import math
from collections.abc import Sequence
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
from lfpipe.render.display.overlay import Overlay
from lfpipe.render.ui.calibration import ACCEPT, Distance, StillEyes
from lfpipe.track.make_engine import make_engine

PATIENCE_FRAMES = 600  # without a still face before giving up: 20 s at 30 Hz
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


def by_eyes(config: Config, camera: str | None) -> float:
    """The viewer's eye distance in px of a frame of config's size; median over several frames.

    Raises UserError if no face is detected, the face does not stay still, or the source ends.
    """
    eyes = StillEyes()
    width_px, height_px = config.camera.frame_px
    frame: NDArray[np.uint8] = np.empty((height_px, width_px, 3), np.uint8)
    with (
        closing(open_source(camera or config.camera.source, camera_settings(config))) as source,
        closing(make_engine(config.track)) as engine,
    ):
        while eyes.restless <= PATIENCE_FRAMES and source.read(frame) is not None:
            face = engine.detect(frame)
            eyes.add(None if face is None else math.dist(*face.eyes_px.tolist()))
            if eyes.share == 1.0:
                return eyes.median_px
    raise RESTLESS if eyes.seen else NOBODY


def crossed(picture: NDArray[np.uint8], places_px: Sequence[Sequence[float]]) -> NDArray[np.uint8]:
    """A picture with crosses, visible on a white card."""
    drawn = picture.copy()
    for x, y in places_px:
        for colour, thick_px in (((0, 0, 0), 5), ((255, 255, 255), 2)):
            cv2.drawMarker(drawn, (round(x), round(y)), colour, cv2.MARKER_CROSS, 21, thick_px)
    return drawn


def by_card(config: Config, camera: str | None, distance_mm: float) -> tuple[float, float]:
    """Width of the card in px of a frame of config's size, from two clicks on a frozen frame, and
    its distance in mm, which the window may change.

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
    from lfpipe.render.display.window import ScreenWindow
    from lfpipe.render.ui.overlay_view import OverlayView

    width_px, height_px = config.camera.frame_px
    picture: NDArray[np.uint8] = np.empty((height_px, width_px, 3), np.uint8)
    large_px = 2 * width_px, 2 * height_px  # for sub-pixel clicks
    with (
        closing(open_source(camera or config.camera.source, camera_settings(config))) as source,
        closing(ScreenWindow(large_px, "lfpipe calibrate", OverlayView())) as window,
    ):
        while True:
            if not frozen and source.read(picture) is None:
                raise UserError(
                    "the source ended before Enter was pressed",
                    "use a longer recording, ?loop=1, or a camera",
                )
            if not frozen:
                freeze = attrs.evolve(ACCEPT, label="Freeze", off=not distance.is_possible)
                page = Overlay(
                    lines=("Set the distance of the card from the camera, and hold it there.",),
                    items=(*distance.items, freeze),
                    types=True,
                )
            else:
                state = f"{card_px:.1f} px wide. Accept it, or click to start again."
                page = Overlay(
                    lines=(state if card_px else EDGES[len(clicks) % 2],),
                    items=(attrs.evolve(ACCEPT, off=not card_px),),
                )
            window.overlay(page)
            window.show(crossed(picture, clicks))
            for event in window.events():
                if event.name in CANCELS:
                    raise CANCELLED
                if event.name in ACCEPTS and card_px:
                    return card_px, distance.mm
                if not frozen:
                    distance.take(event)
                    frozen = event.name in ACCEPTS and distance.is_possible
                elif event.at_px is not None:
                    del clicks[: 2 * (len(clicks) == 2)]  # a third click starts again
                    clicks.append(event.at_px)
                    card_px = math.dist(*clicks) if len(clicks) == 2 else 0.0
