"""The window of `lfpipe calibrate`: the camera's picture, what is found in it, and the distance."""

import math
from collections.abc import Sequence

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.open_source import camera_settings, open_source
from lfpipe.config import Config
from lfpipe.render.display.open_display import has_display
from lfpipe.render.display.overlay import Event, Item, Overlay

NEAREST_MM, FARTHEST_MM = 100, 5000
STEP_MM = 10  # as exact as a person keeps a distance
SLIDER_MM = 300, 1500  # usual seats
STEPS = {"alpha-": -STEP_MM, "less": -STEP_MM, "alpha+": STEP_MM, "more": STEP_MM}  # by event
RING = 1.6  # radius over the distance of the eyes: around the face
# BGR, the eyes as the lenses of most glasses
GREY, RED, ACCENT = (110, 110, 110), (90, 90, 255), (215, 196, 53)
ACCEPT = Item("Accept", Event("enter"), "Enter")
CANCEL = Item("Cancel", Event("close"), "Esc")


@attrs.define
class Distance:
    """A distance to type, to step or to slide."""

    text: str
    is_new: bool = attrs.field(default=True, init=False)
    """Whether the next digit begins another number."""

    @property
    def mm(self) -> float:
        return float(self.text or 0)

    @property
    def is_possible(self) -> bool:
        return NEAREST_MM <= self.mm <= FARTHEST_MM

    def set(self, mm: float) -> None:
        self.text = f"{min(max(mm, NEAREST_MM), FARTHEST_MM):g}"
        self.is_new = True

    def take(self, event: Event) -> None:
        """Follows an event; others than its own change nothing."""
        if event.name in STEPS:
            self.set(self.mm + STEPS[event.name])
        elif event.name == "distance":
            low, high = SLIDER_MM
            self.set(low + round(event.value * (high - low) / STEP_MM) * STEP_MM)
        elif event == Event("type", "backspace"):
            self.text = self.text[:-1]
            self.is_new = False
        elif event.name == "type":
            self.text = (("" if self.is_new else self.text) + event.text)[: len(str(FARTHEST_MM))]
            self.is_new = False

    @property
    def items(self) -> tuple[Item, ...]:
        low, high = SLIDER_MM
        at = min(max((self.mm - low) / (high - low), 0.0), 1.0)
        return (
            Item("Nearer", Event("alpha-"), "-"),
            Item(f"{self.text or '_'} mm", Event("distance"), slider=at),
            Item("Farther", Event("alpha+"), "+"),
        )


class CameraWindow:
    """The camera and, if there is a screen, a window with its picture and a page over it."""

    def __init__(self, config: Config, camera: str | None) -> None:
        width_px, height_px = config.camera.frame_px
        self.picture: NDArray[np.uint8] = np.empty((height_px, width_px, 3), np.uint8)
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

    def show(self, page: Overlay, picture: NDArray[np.uint8]) -> list[Event]:
        """Shows a picture and a page, and returns what a person did; without a screen, nothing."""
        if self.window is None:
            return []
        self.window.overlay(page)
        self.window.show(picture)
        return self.window.events()

    def close(self) -> None:
        self.source.close()
        if self.window is not None:
            self.window.close()


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


def crossed(picture: NDArray[np.uint8], places_px: Sequence[Sequence[float]]) -> NDArray[np.uint8]:
    """A picture with crosses, visible on a white card."""
    drawn = picture.copy()
    for x, y in places_px:
        for colour, thick_px in (((0, 0, 0), 5), ((255, 255, 255), 2)):
            cv2.drawMarker(drawn, (round(x), round(y)), colour, cv2.MARKER_CROSS, 21, thick_px)
    return drawn
