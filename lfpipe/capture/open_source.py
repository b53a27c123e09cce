"""From what a person typed to an open source; the decoders are imported only for the kind that is asked for."""

from __future__ import annotations

from lfpipe import config
from lfpipe.capture.source import Source
from lfpipe.capture.spec import CameraSpec, DemoSpec, FileSpec, Spec, parse_source
from lfpipe.capture.v4l2 import cameras
from lfpipe.errors import UserError


def resolve(text: str) -> Spec:
    """text parsed; an empty one stands for the first camera found.

    Raises UserError for a text that is no source, and where there is no camera at all.
    """
    if text:
        return parse_source(text)
    found = cameras()
    if not found:
        raise UserError("no camera found", "use --demo, or a recording with --camera file:PATH")
    return CameraSpec(found[0].path)


def open_source(text: str, camera: config.Camera) -> Source:
    """The source that text names, opened: `camera:N`, `camera:/dev/videoN`, `file:PATH[?...]`, `demo`, "" for the first camera.

    Raises UserError where it cannot be opened, with the reason.
    """
    spec = resolve(text)
    if isinstance(spec, FileSpec):
        from lfpipe.replay.sequence import is_sequence

        if is_sequence(spec.path):
            from lfpipe.capture.sequence import SequenceSource

            return SequenceSource(spec, camera)
        from lfpipe.capture.file import FileSource

        return FileSource(spec, camera)
    if isinstance(spec, DemoSpec):
        from lfpipe.capture.demo import DemoSource

        return DemoSource(camera)
    from lfpipe.capture.camera import open_camera

    return open_camera(spec, camera)


def check_source(text: str, camera: config.Camera) -> tuple[str, float]:
    """text, made definite (the first camera found by its path, anything else as it stands), and its rate in Hz.

    It is opened, its first frame is decoded or taken, and it is closed again. Raises UserError as `open_source` does.
    """
    spec = resolve(text)
    definite = f"camera:{spec.path}" if isinstance(spec, CameraSpec) else text
    source = open_source(definite, camera)
    source.close()
    return definite, source.info.rate_hz
