"""Measures an object of known size in the camera's picture. A window guides the user if there is a screen."""

import math
from collections import deque
from collections.abc import Collection
from contextlib import ExitStack, closing

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.open_source import open_source
from lfpipe.config import Config
from lfpipe.errors import UserError
from lfpipe.render.display import has_display
from lfpipe.track.engine import make_engine

MEASURED_FRAMES = 45  # with a face: one and a half seconds
SPREAD = 0.05  # quartiles further apart than this share of the median: the viewer moved
PATIENCE_FRAMES = 600  # frames without a still face before giving up
EDGES = ("Click the middle of one short edge.", "First edge marked. Click the middle of the other short edge.")
AGAIN = UserError("nothing was measured", "start again when you are ready")
NOBODY = UserError(
    "no face was detected", "sit in good light and look into the camera; `lfpipe up --demo --camera SRC` shows its picture"
)
RESTLESS = UserError("the eyes did not stay still long enough", "rest your head, keep the distance, and try again")


def _mark(picture: NDArray[np.uint8], x: float, y: float) -> None:
    """A white cross with a dark outline, visible on a face and on a white card."""
    for colour, thick_px in (((0, 0, 0), 5), ((255, 255, 255), 2)):
        cv2.drawMarker(picture, (round(x), round(y)), colour, cv2.MARKER_CROSS, 21, thick_px)


def median_of(apart_px: Collection[float]) -> tuple[float, bool]:
    """The median of distances, and whether the viewer kept still enough for it; 0 of none."""
    low, median, high = np.percentile(list(apart_px) or [0.0], (25, 50, 75)).tolist()
    return median, high - low <= SPREAD * median > 0


def by_eyes(config: Config, camera: str | None, distance_mm: float) -> float:
    """Distance between the viewer's eyes in px of a frame of config's size; median over several frames.

    Raises UserError if no face is detected, the face does not stay still, the source ends, or the user cancels.
    """
    width_px, height_px = config.camera.frame_px
    picture: NDArray[np.uint8] = np.empty((height_px, width_px, 3), np.uint8)
    apart_px: deque[float] = deque(maxlen=MEASURED_FRAMES)
    median_px, still, guide, missed = 0.0, False, None, 0
    with ExitStack() as stack:
        source = stack.enter_context(closing(open_source(camera or config.camera.source, config.camera)))
        engine = stack.enter_context(closing(make_engine(config.track)))
        if has_display():
            from lfpipe.render.window import CalibrationWindow

            guide = stack.enter_context(closing(CalibrationWindow(config.camera.frame_px, "lfpipe calibrate")))
        while not (len(apart_px) == MEASURED_FRAMES and still and (guide is None or guide.enter)):
            if source.read(picture) is None or missed > PATIENCE_FRAMES:
                raise RESTLESS if apart_px else NOBODY
            face = engine.detect(picture)
            if face is not None:
                apart_px.append(math.dist(*face.eyes_px.tolist()))
            median_px, still = median_of(apart_px)
            missed = missed + 1 if face is None or not still else 0
            if guide is None:
                continue
            for x, y in face.eyes_px.tolist() if face is not None else ():
                _mark(picture, x, y)
            state = f"eyes {median_px:.1f} px apart" if face is not None else "no face detected"
            ask = f"Eyes {distance_mm:g} mm from the camera. Look into it and keep still."
            guide.enter = False
            guide.step(picture, [ask, state, "Enter accepts, Esc cancels"])
            if guide.quit:
                raise AGAIN
    return median_px


def by_card(config: Config, camera: str | None, distance_mm: float) -> float:
    """Width of the card in px of a frame of config's size, from two clicks on a frozen frame.

    Raises UserError without a screen, if the source ends before a frame is frozen, or if the user cancels.
    """
    if not has_display():
        raise UserError("--by card needs a screen for a window to click in", "run it on a desktop, or use --by eyes")
    from lfpipe.render.window import CalibrationWindow

    width_px, height_px = config.camera.frame_px
    picture: NDArray[np.uint8] = np.empty((height_px, width_px, 3), np.uint8)
    with (
        closing(open_source(camera or config.camera.source, config.camera)) as source,
        closing(CalibrationWindow(config.camera.frame_px, "lfpipe calibrate")) as guide,
    ):
        while not guide.enter:
            if source.read(picture) is None:
                raise UserError("the source ended before Enter was pressed", "use a longer recording, ?loop=1, or a camera")
            guide.step(picture, [f"Card {distance_mm:g} mm from the camera, facing it.", "Enter freezes it, Esc cancels"])
            if guide.quit:
                raise AGAIN
        guide.clicks.clear()
        while True:
            del guide.clicks[: 2 * (len(guide.clicks) > 2)]  # a third click starts again
            marked, card_px = picture.copy(), 0.0
            for x, y in guide.clicks:
                _mark(marked, x, y)
            if len(guide.clicks) < 2:
                lines = [EDGES[len(guide.clicks)], "Esc cancels"]
            else:
                card_px = math.dist(*guide.clicks)
                lines = [f"{card_px:.1f} px wide. Enter accepts, a click starts again, Esc cancels"]
            guide.enter = False
            guide.step(marked, lines)
            if guide.quit:
                raise AGAIN
            if guide.enter and card_px:
                return card_px
