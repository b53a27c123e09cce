"""Opens a source by its name; imports the decoders of its kind only."""

from importlib import import_module
from typing import Any

import attrs
import cv2
import numpy as np

from lfpipe import config
from lfpipe.capture.camera_list import CameraFinder, describe, first_camera, with_time_limit
from lfpipe.capture.frame_source import FrameSource, SourceInfo, orient, undecodable
from lfpipe.capture.spec import CameraSpec, DemoSpec, FileSpec, Spec, parse_source
from lfpipe.config.modes import CameraViewer, Clock, Live, Lossless, RecordedEyes
from lfpipe.errors import UserError
from lfpipe.host import PORTABLE
from lfpipe.host.processes import usable_cores

CAMERA_S, FILE_S = 15.0, 60.0  # longest time a source may take to open


def _driver() -> Any:
    """The module of this system that has `open_camera` and `check_camera`."""
    return import_module(f"lfpipe.capture.{'opencv_camera' if PORTABLE else 'camera'}")


def resolve(text: str) -> Spec:
    """Parses text; an empty one stands for the first camera.

    Raises UserError if text names no source, NoCamera if there is no camera at all.
    """
    return parse_source(text) if text else first_camera()


def camera_name(text: str) -> str:
    """The name of a source in measurements: the driver's name of a camera, wherever it is plugged
    in.

    Raises UserError as `resolve` does.
    """
    spec = resolve(text)
    if isinstance(spec, CameraSpec):
        return spec.name or describe(spec.path).name or str(spec.path)
    return f"file:{spec.path.absolute()}" if isinstance(spec, FileSpec) else "demo"


def camera_settings(settings: config.Config) -> config.Camera:
    """[camera], at no higher a rate than the session can use: FaceMesh takes most of a core at 30
    Hz, and two cores are busy with pictures.
    """
    camera = settings.camera
    slow = settings.track.engine == "mediapipe" or len(usable_cores()) <= 2
    return attrs.evolve(camera, rate_hz=camera.nominal_hz) if slow else camera


def open_source(text: str, camera: config.Camera, reconnect: bool = False) -> FrameSource:
    """Opens the source that text names, in one of the forms of `spec.FORMS`, or the first camera
    for an empty text.

    camera.rotate and camera.mirror apply to cameras and videos; sequences were recorded upright.
    reconnect: retry a device that cannot be opened or is lost later, see `ReconnectingCamera`.
    Raises UserError with the reason if it cannot be opened.
    """
    waits = reconnect and not text
    spec = None if waits else resolve(text)
    if isinstance(spec, FileSpec):
        from lfpipe.capture.recordings import FileSource
        from lfpipe.sequence.folder import is_sequence

        source = FileSource(spec, camera)
        return source if is_sequence(spec.path) else orient(source, camera)
    if isinstance(spec, DemoSpec):
        from lfpipe.capture.demo import DemoSource

        return DemoSource(camera)
    driver = _driver()
    finder = CameraFinder(spec)
    if not reconnect:
        return orient(driver.open_camera(finder.path(), camera), camera)
    from lfpipe.capture.reconnecting_camera import ReconnectingCamera

    info = SourceInfo(
        str(spec or "camera"), (camera.width_px, camera.height_px), camera.nominal_hz, live=True
    )
    return orient(
        ReconnectingCamera(info, lambda: driver.open_camera(finder.path(), camera)), camera
    )


def _tried(text: str, camera: config.Camera) -> SourceInfo:
    """Opens the source, reads the first frame of a recording, closes it.

    A camera is configured, but not started.
    """
    spec = parse_source(text)
    if isinstance(spec, CameraSpec):
        info: SourceInfo = _driver().check_camera(CameraFinder(spec).path(), camera)
        return attrs.evolve(info, jpeg=info.jpeg and not (camera.rotate or camera.mirror))
    try:
        source = open_source(text, camera)
    except (MemoryError, cv2.error) as error:
        raise undecodable(text, error) from None
    try:
        width_px, height_px = camera.frame_px
        source.read(np.empty((height_px, width_px, 3), np.uint8))
    finally:
        source.close()
    return source.info


def clock_of(text: str) -> Clock:
    """The clock of a session on a source: a file may ask for none. Raises UserError as
    `resolve` does.
    """
    spec = resolve(text)
    return Lossless() if isinstance(spec, FileSpec) and spec.pace == "max" else Live()


def check_source(text: str, camera: config.Camera) -> CameraViewer | RecordedEyes:
    """Opens the source, decodes its first frame and closes it: returns the viewer in it, with its
    definite name (a path for the first camera).

    Raises UserError as `open_source` does, and after CAMERA_S or FILE_S.
    """
    spec = resolve(text)
    is_camera = isinstance(spec, CameraSpec)
    definite = str(spec) if is_camera else text
    try:
        info = with_time_limit(CAMERA_S if is_camera else FILE_S, lambda: _tried(definite, camera))
    except TimeoutError as error:
        remedy = (
            "unplug the camera and plug it in again"
            if is_camera
            else "check its disk or network drive"
        )
        raise UserError(f"{definite}: {error.strerror}", remedy) from None
    if info.eyes:
        return RecordedEyes(source=definite, rate_hz=info.rate_hz, folder=info.eyes)
    jpeg_px = info.size_px if info.jpeg else None
    return CameraViewer(source=definite, rate_hz=info.rate_hz, jpeg_px=jpeg_px)
