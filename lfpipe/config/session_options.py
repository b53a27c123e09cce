"""What a session's stages need besides the configuration: facts detected by `up`, and later
requests. The kinds of viewer, clock and display of a session are one class each,
parsed once, early.

A stage receives all options at its start (pickled) and with each change (as a map in a control
message).
"""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, cast, get_origin

import attrs

from lfpipe.config.tree import Config

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


if TYPE_CHECKING:
    from cattrs import BaseConverter


@attrs.frozen(kw_only=True)
class SceneSummary:
    """Facts about a packed scene that a session needs without opening it."""

    # the pack's folder, absolute
    pack: str
    name: str
    # of the grid
    rows: int
    cols: int
    # of a view
    height_px: int
    width_px: int
    # the one used for render.method = "auto"
    method: str
    has_disparity: bool
    # whether the packer has finished; until then there is no disparity
    complete: bool = True
    # PSNR in dB of each method on held-out views
    scores: Mapping[str, float] = attrs.field(factory=dict)
    # of each method at each of `quality.SIZES`, in grey levels, see `lightfield.MethodScores`
    errors: Mapping[str, tuple[float, ...]] = attrs.field(factory=dict)
    # of the farthest and nearest points, px per view
    disparity_min_px: float = 0.0
    disparity_max_px: float = 0.0
    # whether the depth is inverted against the order of the pack
    depth_inverted: bool = False
    # whether the picture depends on the eyes
    needs_eyes: bool = attrs.field(
        default=attrs.Factory(lambda self: self.rows * self.cols > 1, takes_self=True)
    )
    # of light-field video, 1 of a still
    frames: int = 1

    def shown_as(self, invert_depth: str) -> Self:
        """With the depth order of scene.invert_depth; "auto" changes nothing."""
        if invert_depth == "auto" or (invert_depth == "yes") == self.depth_inverted:
            return self
        low, high = -self.disparity_max_px, -self.disparity_min_px
        return attrs.evolve(
            self,
            disparity_min_px=low,
            disparity_max_px=high,
            depth_inverted=not self.depth_inverted,
        )


@attrs.frozen(kw_only=True)
class Placement:
    """How the second of two cameras stands against the first one."""

    # px of a view by which its picture lies lower
    height_px: float = 0.0
    # clockwise
    rotation_deg: float = 0.0
    # of its picture
    scale: float = 1.0
    # whether the first one delivers the right view
    swapped: bool = False


@attrs.frozen(kw_only=True)
class LiveSource:
    """A source that delivers all views of a light field in each frame."""

    # as camera.source, or ring:NAME
    source: str
    # of the grid
    rows: int
    cols: int
    # tiles of a frame across, in which the views lie row by row
    tiles_across: int
    # (width, height)
    frame_px: tuple[int, int]
    # whether a program draws it, which may know its disparity
    drawn: bool = False
    # of two cameras, measured by `lfpipe calibrate`
    placement: Placement | None = None

    @property
    def width_px(self) -> int:
        """Of a view."""
        return self.frame_px[0] // self.tiles_across

    @property
    def height_px(self) -> int:
        """Of a view."""
        return self.frame_px[1] * self.tiles_across // (self.rows * self.cols)

    def tile(self, view: tuple[int, int]) -> tuple[int, int]:
        """(row, column) of a view's tile in a frame."""
        return divmod(view[0] * self.cols + view[1], self.tiles_across)


@attrs.frozen(kw_only=True)
class QualityLevel:
    """One level of quality."""

    # 0 for full quality
    number: int = 0
    # what it makes less of: "pictures" or "eyes", "" for level 0
    work: str = ""
    # how views are made
    method: str
    # width of the pictures, as a share of that on the screen
    size: float = 1.0
    # of the display's clock
    rate_hz: float
    # n: one frame in n is tracked
    every: int = 1
    # of a live light field: 0 is full, 1 for every second frame, 2 with the fastest estimator, too
    disparity: int = 0
    # for people
    words: str = "full"


@attrs.frozen(kw_only=True)
class DrawingCosts:
    """What the stage that shows pictures measured of their drawing."""

    # CPU time for each drawn pixel, by method
    ns_per_px: Mapping[str, float]
    # pixels of the picture on the screen
    picture_px: int
    # cores that may draw it
    cores: int


@attrs.frozen(kw_only=True)
class SessionOptions:
    """What a session does. Paths are absolute; "" means none."""

    scene: SceneSummary | None = None
    viewer: Viewer = attrs.field(factory=CameraViewer)
    clock: Clock = attrs.field(factory=Live)
    # whether pictures are made
    show: bool = True
    display: Target = attrs.field(factory=Nothing)
    # file of one line per picture
    trace: str = ""
    # file for the last picture
    still: str = ""
    # folder of a running recording
    record: str = ""
    # names of rings that exist only on demand
    pictures: str = ""
    # the scene, if it is captured now
    live: LiveSource | None = None
    # what stages of other packages work on, by the name of the stage
    extras: Mapping[str, tuple[str, ...]] = attrs.field(factory=dict)
    # rings on demand that such stages read now
    asked_for: tuple[str, ...] = ()
    # the scenes to step through, and the index of the one on show
    playlist: tuple[str, ...] = ()
    playlist_at: int = 0
    # those that could not be opened, and why
    unusable: Mapping[str, str] = attrs.field(factory=dict)
    # begin with the thumbnails of the playlist
    start: bool = False
    # begin with the page that measures the camera, at this distance; 0: do not
    calibrate_mm: float = 0.0
    # ask which glasses the user has
    ask_glasses: bool = False
    # nobody has looked for a while: cameras are read less often
    idle: bool = False
    # None until they are measured
    costs: DrawingCosts | None = None
    # the quality in force, None for full
    level: QualityLevel | None = None

    @property
    def lock_code(self) -> str:
        """The code that closes a locked window; "" if the window is not locked."""
        return self.display.lock_code if isinstance(self.display, Window) else ""

    @property
    def every_s(self) -> float:
        """After how many seconds a locked window shows the next scene; 0: never."""
        return self.display.every_s if isinstance(self.display, Window) else 0.0

    def extra(self, stage: str) -> tuple[str, ...]:
        """What a stage of another package works on; nothing if it does not run."""
        return self.extras.get(stage, ())

    @property
    def pack(self) -> str:
        """The scene's pack, "" without a scene."""
        return self.scene.pack if self.scene else ""

    @property
    def complete(self) -> bool:
        """Whether the scene has its disparity, as far as there is any."""
        return self.scene is None or self.scene.complete


@attrs.frozen(kw_only=True)
class Snapshot:
    """What a session works by: the answer to `hello`, and the message to its stages."""

    # counts changes
    rev: int
    config: Config
    options: SessionOptions
    paused: bool


@functools.cache
def converter() -> "BaseConverter":
    """Turns configuration and options into plain values for messages and files, and back,
    unchecked. A class of a union carries its name as `_type`.
    """
    from cattrs import BaseConverter
    from cattrs.preconf.msgpack import configure_converter
    from cattrs.strategies import configure_tagged_union

    plain = BaseConverter(detailed_validation=False)
    configure_converter(plain)
    # a plug-in's name is no word of the key's
    plain.register_structure_hook_func(
        lambda kind: get_origin(cast(Any, kind)) is Literal, lambda value, _: value
    )
    for union in (Viewer, Clock, Target):
        configure_tagged_union(union, plain)
    return plain
