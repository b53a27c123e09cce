"""Measuring one thing of known size in the camera's picture, with a window that guides where there is a screen."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.capture.open_source import open_source
from lfpipe.config import Config
from lfpipe.errors import UserError
from lfpipe.render.open_display import check_display, has_display
from lfpipe.track.calibration import EyeGauge
from lfpipe.track.engines import make_engine

PATIENCE_FRAMES = 600  # without a face, or without a still one, for so long
AGAIN = UserError("nothing was measured", "start again when you are ready")


def _frame(config: Config) -> NDArray[np.uint8]:
    return np.empty((config.camera.height_px, config.camera.width_px, 3), np.uint8)


def _mark(picture: NDArray[np.uint8], x: float, y: float) -> None:
    cv2.drawMarker(picture, (round(x), round(y)), (255, 255, 255), cv2.MARKER_CROSS, 21, 2)


def by_eyes(config: Config, camera: str | None, distance_mm: float) -> float:
    """Distance between the viewer's eyes in px of a frame of config's size, the median of some frames.

    Raises UserError where no face is seen, nobody keeps still, or the person ends it.
    """
    source = open_source(camera or config.camera.source, config.camera)
    engine, gauge, guide, picture, missed = make_engine(config.track), EyeGauge(), None, _frame(config), 0
    ask = f"Eyes {distance_mm:g} mm from the camera, look into it, keep still."
    try:
        if has_display():
            from lfpipe.render.guide import Guide

            guide = Guide((config.camera.width_px, config.camera.height_px), "lfpipe calibrate")
        while not (gauge.full and gauge.steady and (guide is None or guide.enter)):
            if source.read(picture) is None or missed > PATIENCE_FRAMES:
                raise UserError("no steady face was seen", "sit still in the light, looking into the camera, and try again")
            face = engine.detect(picture)
            gauge.add(face)
            missed = missed + 1 if face is None or not gauge.steady else 0
            if guide is None:
                continue
            for x, y in face.eyes_px.tolist() if face is not None else ():
                _mark(picture, x, y)
            state = f"eyes {gauge.median_px:.1f} px apart" if face is not None else "no face seen"
            guide.enter = False
            guide.step(picture, [ask, state, "Enter takes it, Esc ends"])
            if guide.quit:
                raise AGAIN
        return gauge.median_px
    finally:
        if guide is not None:
            guide.close()
        engine.close()
        source.close()


def by_card(config: Config, camera: str | None, distance_mm: float) -> float:
    """Width of the card in px, from two clicks on a frozen frame. Raises UserError without a screen, or where it is ended."""
    check_display("window")
    source, picture, frozen = open_source(camera or config.camera.source, config.camera), _frame(config), False
    from lfpipe.render.guide import Guide

    guide = Guide((config.camera.width_px, config.camera.height_px), "lfpipe calibrate")
    try:
        while len(guide.clicks) < 2:
            if not frozen:
                guide.clicks.clear()
                if source.read(picture) is None:
                    raise UserError("the source ended before the card was clicked", "a longer recording, or a camera")
            frozen = guide.enter
            for x, y in guide.clicks:
                _mark(picture, x, y)
            hold = f"Card {distance_mm:g} mm from the camera, flat to it. Enter freezes the picture."
            guide.step(picture, ["Click the middle of both short edges." if frozen else hold, "Esc ends"])
            if guide.quit:
                raise AGAIN
        (x0, y0), (x1, y1) = guide.clicks[:2]
        return math.hypot(x1 - x0, y1 - y0)
    finally:
        guide.close()
        source.close()
