"""The kinds of viewer, clock and display of a session: one class each, parsed once, early."""

from pathlib import Path

import attrs

# The viewer: where the eyes come from. Every kind has source, rate_hz, jpeg_px and tracked.


@attrs.frozen(kw_only=True)
class CameraViewer:
    """A person in front of a camera, or in a video."""

    # the camera or file, fully named; "": the first camera
    source: str = ""
    # of its frames; 0: unknown
    rate_hz: float = 0.0
    # (width, height) of the JPEGs that it delivers
    jpeg_px: tuple[int, int] | None = None
    # whether eyes are tracked: a scene of one view needs none
    tracked: bool = True
    # of the camera in measurements; "": unknown
    name: str = ""


@attrs.frozen(kw_only=True)
class RecordedEyes:
    """The eyes that a recorded session of the mouse holds in place of frames."""

    # of the recording, which gives the times
    source: str
    rate_hz: float
    jpeg_px = None
    # the recording
    folder: str
    # whether the eyes are published: a scene of one view needs none
    tracked: bool = True


@attrs.frozen
class MouseViewer:
    """No camera: the mouse over the window is the viewer."""

    source = "mouse"
    rate_hz = 0.0
    jpeg_px = None
    tracked = False


@attrs.frozen
class NoViewer:
    """No eyes at all: the scene has one view."""

    source = ""
    rate_hz = 0.0
    jpeg_px = None
    tracked = False


Viewer = CameraViewer | RecordedEyes | MouseViewer | NoViewer


def is_measurable(viewer: Viewer) -> bool:
    """Whether there are frames with eyes, by which a camera is measured."""
    return isinstance(viewer, CameraViewer) and viewer.tracked


def watching(viewer: Viewer, needs_eyes: bool) -> Viewer:
    """The viewer of a session that continues with another scene; a session without one looks for
    the first camera when a scene needs eyes.
    """
    match viewer:
        case CameraViewer() | RecordedEyes():
            return attrs.evolve(viewer, tracked=needs_eyes)
        case NoViewer() if needs_eyes:
            return CameraViewer()
        case _:
            return viewer


# The clock: whether time passes. Every kind has output: where a deterministic replay writes.


@attrs.frozen
class ReplayOutput:
    """Where a deterministic replay writes."""

    # of the results
    folder: str
    # the recording replayed
    sequence: str
    # whether to store some pictures
    pictures: bool


@attrs.frozen
class Live:
    """Time passes: late frames are dropped, and a picture is made for its display time."""

    output = None


@attrs.frozen(kw_only=True)
class Lossless:
    """No time passes: writers wait for readers, and results depend on the frames alone."""

    # whether a frame passes every stage before the next one starts
    lock_step: bool = False
    output: ReplayOutput | None = None


Clock = Live | Lossless


def device_latency_ms(clock: Clock, measured_ms: float) -> float:
    """The delay of camera and display to predict over. measured_ms: render.device_latency_ms."""
    return 0.0 if isinstance(clock, Lossless) else measured_ms


# The target: where pictures go.


@attrs.frozen(kw_only=True)
class Window:
    """A window on a screen: `--display window` or `fullscreen`."""

    # whether it fills the screen
    fullscreen: bool = False
    # the code that closes it, the only keys that a locked window accepts; "" if it is not locked
    lock_code: str = attrs.field(default="", repr=False)
    # after so many seconds a locked window shows the next scene; 0: never
    every_s: float = 0.0
    # of an exhibition
    title: str = ""

    def __str__(self) -> str:
        return "fullscreen" if self.fullscreen else "window"


@attrs.frozen
class VideoFile:
    """A video: `--display file:PATH`."""

    path: Path

    def __str__(self) -> str:
        return f"file:{self.path}"


@attrs.frozen
class Nothing:
    """Pictures are made, and shown nowhere: `--display none`."""

    def __str__(self) -> str:
        return "none"


@attrs.frozen
class Plugin:
    """A display of another package: `--display NAME[:ARGUMENT]`."""

    name: str
    argument: str = ""

    def __str__(self) -> str:
        return f"{self.name}:{self.argument}" if self.argument else self.name


Target = Window | VideoFile | Nothing | Plugin
