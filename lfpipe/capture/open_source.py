"""From what a person typed to an open source; the decoders are imported only for the kind that is asked for."""

from __future__ import annotations

import attrs
import numpy as np

from lfpipe import config
from lfpipe.capture.limited import within
from lfpipe.capture.mounting import oriented
from lfpipe.capture.source import Source, SourceInfo, decoding
from lfpipe.capture.spec import CameraSpec, DemoSpec, FileSpec, Spec, parse_source
from lfpipe.capture.v4l2 import cameras
from lfpipe.errors import UserError

CAMERA_S, FILE_S = 15.0, 60.0  # how long a source may take to open, at most


def resolve(text: str) -> Spec:
    """text parsed; an empty one stands for the first camera found.

    Raises UserError for a text that is no source, and where there is no camera at all.
    """
    if text:
        return parse_source(text)
    found = cameras()
    if not found:
        raise UserError("no camera found", "use --camera demo, or a recording with --camera file:PATH")
    return CameraSpec(found[0].path)


def open_source(text: str, camera: config.Camera) -> Source:
    """The source that text names, opened: `camera:N`, `camera:/dev/videoN`, `file:PATH[?...]`, `demo`, "" for the first camera.

    A camera or a video is turned as camera.rotate and camera.mirror say; a recorded sequence was when it was recorded.
    Raises UserError where it cannot be opened, with the reason.
    """
    spec = resolve(text)
    if isinstance(spec, FileSpec):
        from lfpipe.sequence.folder import is_sequence

        if is_sequence(spec.path):
            from lfpipe.capture.sequence import SequenceSource

            return SequenceSource(spec, camera)
        from lfpipe.capture.file import FileSource

        return oriented(FileSource(spec, camera), camera)
    if isinstance(spec, DemoSpec):
        from lfpipe.capture.demo import DemoSource

        return DemoSource(camera)
    from lfpipe.capture.camera import open_camera

    return oriented(open_camera(spec, camera), camera)


def open_reconnecting(text: str, camera: config.Camera) -> Source:
    """As `open_source`, but a device that cannot be opened, or is lost later, is tried again: see `ReconnectingCamera`."""
    spec = resolve(text)
    if not isinstance(spec, CameraSpec):
        return open_source(text, camera)
    from lfpipe.capture import camera as device
    from lfpipe.capture.reconnecting_camera import ReconnectingCamera

    info = SourceInfo(f"camera:{spec.path}", camera.width_px, camera.height_px, camera.rate_hz, live=True)
    return oriented(ReconnectingCamera(info, lambda: device.open_camera(spec, camera)), camera)


@attrs.frozen
class Checked:
    """A source that was open a moment ago. text: what to open, definite. jpeg_px: width and height of the JPEGs that it
    delivers, None where it delivers none.
    """

    text: str
    rate_hz: float
    jpeg_px: tuple[int, int] | None = None


def _tried(text: str, camera: config.Camera) -> SourceInfo:
    """Opens the source, takes the first frame of a recording (a camera has been asked for one), and closes it."""
    with decoding(text):
        source = open_source(text, camera)
    try:
        if not source.info.live:
            width_px, height_px = camera.frame_px
            source.read(np.empty((height_px, width_px, 3), np.uint8))
    finally:
        source.close()
    return source.info


def check_source(text: str, camera: config.Camera) -> Checked:
    """text, made definite (the first camera found by its path, anything else as it stands), and what it delivers.

    It is opened, its first frame is decoded or taken, and it is closed again. Raises UserError as `open_source` does, and where
    it takes longer than CAMERA_S or FILE_S.
    """
    spec = resolve(text)
    definite = f"camera:{spec.path}" if isinstance(spec, CameraSpec) else text
    limit_s, remedy = CAMERA_S, "plug it out and in again"
    if not isinstance(spec, CameraSpec):
        limit_s, remedy = FILE_S, "is its disk or network drive there?"
    try:
        info = within(limit_s, lambda: _tried(definite, camera))
    except TimeoutError as error:
        raise UserError(f"{definite}: {error}", remedy) from None
    return Checked(definite, info.rate_hz, (info.width_px, info.height_px) if info.jpeg else None)
