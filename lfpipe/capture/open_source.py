"""Opens a source by its name; imports the decoders of its kind only."""

from functools import partial

import attrs
import cv2
import numpy as np

from lfpipe import config
from lfpipe.capture.camera_list import first_camera, with_time_limit
from lfpipe.capture.frame_source import FrameSource, SourceInfo, orient, undecodable
from lfpipe.capture.spec import CameraSpec, FileSpec, SourceKind, parse_source
from lfpipe.config.modes import CameraViewer, Clock, Live, Lossless, RecordedEyes
from lfpipe.errors import UserError, redacted
from lfpipe.host.processes import usable_cores
from lfpipe.plugins import IN_USE, blaming


def resolve(text: str) -> SourceKind:
    """Parses text; an empty text selects the first camera.

    Raises UserError if text names no source, NoCamera if there is no camera at all.
    """
    return parse_source(text) if text else first_camera()


def definite_name(source: SourceKind, text: str) -> str:
    """The name of a source, and no longer "the first camera". text: the one that was parsed."""
    return str(source) if isinstance(source, CameraSpec) else text


def camera_name(text: str) -> str:
    """The name of a source in measurements: the driver's name of a camera, wherever it is plugged
    in.

    Raises UserError as `resolve` does.
    """
    return resolve(text).name_in_measurements(text)


def camera_settings(settings: config.Config) -> config.Camera:
    """[camera], at most at the rate that the session can use: FaceMesh takes most of a core at 30
    Hz, and two cores are busy with pictures.
    """
    camera = settings.camera
    slow = settings.track.engine == "mediapipe" or len(usable_cores()) <= 2
    return attrs.evolve(camera, rate_hz=camera.nominal_hz) if slow else camera


def live_camera(settings: config.Config, frame_px: tuple[int, int]) -> config.Camera:
    """[camera] for frames of a live light field, which no setting turns."""
    return attrs.evolve(
        settings.camera, width_px=frame_px[0], height_px=frame_px[1], rotate=0, mirror=False
    )


@blaming(IN_USE)
def open_source(text: str, camera: config.Camera, reconnect: bool = False) -> FrameSource:
    """Opens the source that text names, in one of `spec.forms`, or the first camera for an empty
    text.

    camera.rotate and camera.mirror apply to cameras and videos; sequences were recorded upright.
    reconnect: retry a live source that cannot be opened or is lost later, see `ReconnectingCamera`.
    Raises UserError with the reason if it cannot be opened.
    """
    spec = CameraSpec() if reconnect and not text else resolve(text)
    if reconnect and spec.live:
        from lfpipe.capture.reconnecting_camera import ReconnectingCamera

        info = SourceInfo(
            redacted(str(spec)), (camera.width_px, camera.height_px), camera.nominal_hz, live=True
        )
        source: FrameSource = ReconnectingCamera(info, partial(spec.open, camera))
    else:
        source = spec.open(camera)
    return source if spec.upright else orient(source, camera)


@blaming(IN_USE)
def _tried(text: str, camera: config.Camera) -> SourceInfo:
    """Opens the source, reads the first frame of a recording, closes it.

    A camera is configured, but not started.
    """
    if (info := parse_source(text).probe(camera)) is not None:
        return attrs.evolve(info, jpeg=info.jpeg and not (camera.rotate or camera.mirror))
    try:
        source = open_source(text, camera)
    except (MemoryError, cv2.error) as error:
        raise undecodable(redacted(text), error) from None
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
    source = resolve(text)
    return Lossless() if isinstance(source, FileSpec) and source.pace == "max" else Live()


def probe_source(text: str, camera: config.Camera) -> SourceInfo:
    """What the source delivers: opens it, decodes its first frame and closes it.

    Raises UserError as `open_source` does, and after its time limit.
    """
    spec = resolve(text)
    try:
        return with_time_limit(spec.time_limit_s, lambda: _tried(text, camera))
    except TimeoutError as error:
        raise UserError(f"{redacted(text)}: {error.strerror}", spec.remedy) from None


def check_source(text: str, camera: config.Camera) -> CameraViewer | RecordedEyes:
    """Opens the source, decodes its first frame and closes it: returns the viewer in it, with its
    definite name (a path for the first camera).

    Raises UserError as `open_source` does, and after its time limit.
    """
    spec = resolve(text)
    definite = definite_name(spec, text)
    info = probe_source(definite, camera)
    if info.eyes:
        return RecordedEyes(source=definite, rate_hz=info.rate_hz, folder=info.eyes)
    jpeg_px = info.size_px if info.jpeg else None
    name = spec.name_in_measurements(definite)
    return CameraViewer(source=definite, rate_hz=info.rate_hz, jpeg_px=jpeg_px, name=name)
