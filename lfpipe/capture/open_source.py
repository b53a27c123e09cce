"""Opens a source by its name; imports the decoders of its kind only."""

from importlib import import_module
from typing import Any

import attrs
import numpy as np

from lfpipe import config
from lfpipe.capture.camera_list import known, with_time_limit
from lfpipe.capture.frame_source import FrameSource, SourceInfo, decoding, orient
from lfpipe.capture.spec import CameraSpec, DemoSpec, FileSpec, Spec, parse_source
from lfpipe.errors import UserError
from lfpipe.host import PORTABLE

MOUSE = "mouse"
CAMERA_S, FILE_S = 15.0, 60.0  # longest time a source may take to open


class NoCamera(UserError):
    """Raised where the first camera is asked for and there is none: a session goes on with the mouse."""


def _cameras() -> Any:
    """The module of this system that opens cameras: `CameraFinder`, `open_camera`, `check_camera`."""
    return import_module(f"lfpipe.capture.{'opencv_camera' if PORTABLE else 'camera'}")


def resolve(text: str) -> Spec:
    """Parses text; an empty one stands for the first camera.

    Raises UserError if text names no source, NoCamera if there is no camera at all.
    """
    if text:
        return parse_source(text)
    first = known().first_camera()
    if first is None:
        raise NoCamera("no camera found", known().none_usable())
    return CameraSpec(first)


def camera_name(text: str) -> str:
    """The name of a source in measurements: the driver's name of a camera, wherever it is plugged in.

    Raises UserError as `resolve` does.
    """
    spec = resolve(text)
    if isinstance(spec, CameraSpec):
        return spec.name or known().describe(spec.path).name or spec.path.as_posix()
    return f"file:{spec.path.absolute()}" if isinstance(spec, FileSpec) else "demo"


def open_source(text: str, camera: config.Camera) -> FrameSource:
    """Opens the source that text names, in one of the forms of `spec.FORMS`, or the first camera for an empty text.

    camera.rotate and camera.mirror apply to cameras and videos; sequences were recorded upright. Raises UserError with the reason
    if it cannot be opened.
    """
    spec = resolve(text)
    if isinstance(spec, FileSpec):
        from lfpipe.capture.file_source import FileSource
        from lfpipe.sequence.folder import is_sequence

        source = FileSource(spec, camera)
        return source if is_sequence(spec.path) else orient(source, camera)
    if isinstance(spec, DemoSpec):
        from lfpipe.capture.demo import DemoSource

        return DemoSource(camera)
    device = _cameras()
    return orient(device.open_camera(device.CameraFinder(spec).path(), camera), camera)


def open_reconnecting(text: str, camera: config.Camera) -> FrameSource:
    """As `open_source`, but retries a device that cannot be opened or is lost later: see `ReconnectingCamera`."""
    spec = resolve(text)
    if not isinstance(spec, CameraSpec):
        return open_source(text, camera)
    from lfpipe.capture.reconnecting_camera import ReconnectingCamera

    device = _cameras()
    info = SourceInfo(f"camera:{spec.name or spec.path.as_posix()}", camera.width_px, camera.height_px, camera.rate_hz, live=True)
    finder = device.CameraFinder(spec)
    return orient(ReconnectingCamera(info, lambda: device.open_camera(finder.path(), camera)), camera)


@attrs.frozen
class CheckedSource:
    """A source that has been opened once. text: its definite name, or MOUSE. jpeg_px: (width, height) of its JPEGs, None if it
    delivers none. eyes: as in `SourceInfo`.
    """

    text: str
    rate_hz: float
    jpeg_px: tuple[int, int] | None = None
    eyes: str = ""

    @property
    def options(self) -> config.SessionOptions:
        """Options of a session on this source; text "" for none."""
        spec = parse_source(self.text) if self.text and not self.is_mouse else None
        lossless = isinstance(spec, FileSpec) and spec.pace == "max"
        options = config.SessionOptions(source=self.text, source_hz=self.rate_hz, jpeg_px=self.jpeg_px, lossless=lossless)
        return attrs.evolve(options, mouse=self.is_mouse, eyes=self.eyes, tracking=not self.is_mouse)

    @property
    def is_mouse(self) -> bool:
        """Whether the mouse is the viewer: there is no camera."""
        return self.text == MOUSE


def _tried(text: str, camera: config.Camera) -> SourceInfo:
    """Opens the source, reads the first frame of a recording, closes it. A camera is configured, but not started."""
    spec = parse_source(text)
    if isinstance(spec, CameraSpec):
        device = _cameras()
        info: SourceInfo = device.check_camera(device.CameraFinder(spec).path(), camera)
        return attrs.evolve(info, jpeg=info.jpeg and not (camera.rotate or camera.mirror))
    with decoding(text):
        source = open_source(text, camera)
    try:
        width_px, height_px = camera.frame_px
        source.read(np.empty((height_px, width_px, 3), np.uint8))
    finally:
        source.close()
    return source.info


def check_source(text: str, camera: config.Camera) -> CheckedSource:
    """Opens the source, decodes its first frame and closes it: returns its definite name (a path for the first camera) and
    properties.

    Raises UserError as `open_source` does, and after CAMERA_S or FILE_S.
    """
    spec = resolve(text)
    definite = f"camera:{spec.name or spec.path.as_posix()}" if isinstance(spec, CameraSpec) else text
    limit_s, remedy = CAMERA_S, "unplug the camera and plug it in again"
    if not isinstance(spec, CameraSpec):
        limit_s, remedy = FILE_S, "check its disk or network drive"
    try:
        info = with_time_limit(limit_s, lambda: _tried(definite, camera))
    except TimeoutError as error:
        raise UserError(f"{definite}: {error}", remedy) from None
    return CheckedSource(definite, info.rate_hz, (info.width_px, info.height_px) if info.jpeg else None, info.eyes)
