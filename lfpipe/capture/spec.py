"""Names of frame sources, and the table of their kinds.

    camera:N  camera:/dev/videoN  camera:NAME  file:PATH[?loop=0|1&pace=recorded|max|HZ]  demo
    ring:NAME  row:SOURCE,SOURCE

Another kind is a subclass of `SourceKind`: an entry point of the group `lfpipe.sources`, named as
its prefix, or a line in KINDS. What opens a source is imported when it is opened.
"""

import abc
import contextlib
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, cast

import attrs

from lfpipe import config
from lfpipe.errors import UserError, redacted
from lfpipe.files.safe_files import finite
from lfpipe.host import PORTABLE
from lfpipe.plugins import IN_USE, SOURCES, blaming, load, plugins
from lfpipe.sequence.metrics import RECORDING
from lfpipe.transport.status import Kind, Metric, MetricSet

METRICS = MetricSet(
    *RECORDING,
    Metric("nominal_mhz", Kind.GAUGE, "frames per 1000 s that the camera agreed to deliver"),
    Metric("covered", Kind.FLAG, "its frames show nothing: a shutter, a cover, or no light at all"),
    Metric("offset_us", Kind.GAUGE, "between the frames of cameras in a row that are shown as one"),
)


if TYPE_CHECKING:
    from lfpipe.capture.camera_list import CameraFinder
    from lfpipe.capture.frame_source import FrameSource, SourceInfo

LIVE = "live:"  # begins the name of a scene that is captured now, see `live_source`
# below, it looks like a still picture; above, no camera or disk delivers it
MIN_RATE_HZ, MAX_RATE_HZ = 0.1, 10_000.0
PARAMETERS = f"loop=0|1 and pace=recorded|max|HZ, HZ from {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g}"


def is_live(path: Path | str) -> bool:
    """Whether a scene is captured now."""
    return str(path).startswith(LIVE)


class SourceKind(abc.ABC):
    """A source that is named and not open. The defaults suit most kinds."""

    form: ClassVar[str]
    """The form of its names, for messages."""
    live: ClassVar[bool] = False
    """Whether it is a device or stream, which may appear later, disappear and return."""
    time_limit_s: ClassVar[float] = 60.0
    """Longest time to open it and to read its first frame."""
    remedy: ClassVar[str] = "check its disk or network drive"
    """The remedy if that takes longer."""

    @classmethod
    @abc.abstractmethod
    def parse(cls, rest: str) -> Self | None:
        """The source named by rest, the text after the prefix and the colon; None if there is none.
        Opens no file. Raises UserError that names the wrong part.
        """

    @abc.abstractmethod
    def open(self, camera: config.Camera) -> "FrameSource":
        """Opens it; again, even if the device has moved. Raises UserError."""

    def probe(self, camera: config.Camera) -> "SourceInfo | None":
        """The info that is known without reading a frame; None if it needs the first frame."""
        return None

    def name_in_measurements(self, text: str) -> str:
        """Its name in stored measurements, the same at every port."""
        return redacted(text)

    @property
    def upright(self) -> bool:
        """Whether camera.rotate and camera.mirror do not apply."""
        return False


@attrs.frozen
class CameraSpec(SourceKind):
    """A camera by its device file, or by its name from `lfpipe cameras` (path is then empty). Both
    empty: the first camera available when it is needed.
    """

    path: Path = Path()
    name: str = ""

    form = "camera:N, camera:/dev/videoN, camera:NAME"
    live = True
    time_limit_s = 15.0
    remedy = "unplug the camera and plug it in again"

    def __str__(self) -> str:
        return f"camera:{self.name or self.path}" if self != CameraSpec() else "camera"

    @classmethod
    def parse(cls, rest: str) -> Self | None:
        if rest.isascii() and rest.isdigit():
            return cls(Path(f"/dev/video{int(rest)}"))
        if rest.startswith("/"):
            return cls(Path(rest))
        return cls(Path(), rest.strip()) if rest.strip() else None

    @cached_property
    def _finder(self) -> "CameraFinder":
        from lfpipe.capture.camera_list import CameraFinder

        return CameraFinder(self)

    def open(self, camera: config.Camera) -> "FrameSource":
        return cast("FrameSource", _driver().open_camera(self._finder.path(), camera))

    def probe(self, camera: config.Camera) -> "SourceInfo | None":
        return cast("SourceInfo", _driver().check_camera(self._finder.path(), camera))

    def name_in_measurements(self, text: str) -> str:
        from lfpipe.capture.camera_list import describe

        return self.name or describe(self.path).name or str(self.path)


def _driver() -> Any:
    """The module of this system that has `open_camera` and `check_camera`."""
    return import_module(f"lfpipe.capture.{'opencv_camera' if PORTABLE else 'camera'}")


@attrs.frozen
class FileSpec(SourceKind):
    """A video, a picture or a folder of pictures."""

    path: Path
    loop: bool = True
    pace: float | Literal["recorded", "max"] = "recorded"
    """Recorded times, as fast as it decodes, or a rate in Hz."""
    names_loop: bool = attrs.field(default=False, eq=False)
    """Whether loop was given."""

    form = "file:PATH, file:PATH?loop=0|1&pace=recorded|max|HZ"

    @classmethod
    def parse(cls, rest: str) -> Self:
        path, _, query = rest.rpartition("?") if "?" in rest else (rest, "", "")
        if not path:
            raise UserError("file: has no path", "use for example file:walk.mp4")
        parameters = dict(item.partition("=")[::2] for item in query.split("&") if item)
        loop = parameters.pop("loop", "")
        pace = parameters.pop("pace", "recorded")
        hz = finite(pace, MIN_RATE_HZ, MAX_RATE_HZ)
        if (
            parameters
            or loop not in ("", "0", "1")
            or (pace not in ("recorded", "max") and hz is None)
        ):
            raise UserError(
                f"unknown option {query!r} in {'file:' + rest!r}",
                f"use {PARAMETERS}; if the path of the file contains a '?', append another '?'",
            )
        return cls(
            Path(path).expanduser(),
            loop != "0",
            hz or cast(Literal["recorded", "max"], pace),
            bool(loop),
        )

    def open(self, camera: config.Camera) -> "FrameSource":
        from lfpipe.capture.recordings import FileSource

        return FileSource(self, camera)

    def name_in_measurements(self, text: str) -> str:
        return f"file:{self.path.absolute()}"

    @property
    def upright(self) -> bool:
        """Whether it is a sequence: those were recorded upright."""
        from lfpipe.sequence.folder import is_sequence

        return is_sequence(self.path)


@attrs.frozen
class DemoSpec(SourceKind):
    """The moving portrait."""

    form = "demo"
    upright = True

    @classmethod
    def parse(cls, rest: str) -> Self | None:
        return None if rest else cls()

    def open(self, camera: config.Camera) -> "FrameSource":
        from lfpipe.capture.recordings import DemoSource

        return DemoSource(camera)


@attrs.frozen
class RingKind(SourceKind):
    """The views that another program draws, by `lfpipe.LiveScene`."""

    name: str

    form = "ring:NAME"
    live = True
    remedy = "start the program that draws it"

    @classmethod
    def parse(cls, rest: str) -> Self | None:
        return cls(rest) if rest else None

    def open(self, camera: config.Camera) -> "FrameSource":
        from lfpipe.capture.open_source import RingSource

        return RingSource(self.name)

    def probe(self, camera: config.Camera) -> "SourceInfo | None":
        source = self.open(camera)  # which may write its first frame later
        source.close()
        return source.info


@attrs.frozen
class RowKind(SourceKind):
    """Two to four cameras in a row, from left to right; their pictures side by side."""

    cameras: tuple[SourceKind, ...]
    names: tuple[str, ...]

    form = "row:SOURCE,SOURCE"
    MOST: ClassVar[int] = 4

    @classmethod
    def parse(cls, rest: str) -> Self | None:
        texts = rest.split(",")
        if not 2 <= len(texts) <= cls.MOST or len(set(texts)) < len(texts):
            raise UserError(
                f"row:{rest}: not 2 to {cls.MOST} different cameras",
                "name them from left to right, for example row:camera:2,camera:4",
            )
        return cls(tuple(parse_source(text) for text in texts), tuple(texts))

    @property
    def live(self) -> bool:  # type: ignore[override]
        return self.cameras[0].live

    @property
    def remedy(self) -> str:  # type: ignore[override]
        return self.cameras[0].remedy

    def __str__(self) -> str:
        return f"row:{','.join(self.names)}"

    def name_in_measurements(self, text: str) -> str:
        return ",".join(
            kind.name_in_measurements(name)
            for kind, name in zip(self.cameras, self.names, strict=True)
        )

    def open(self, camera: config.Camera) -> "FrameSource":
        from lfpipe.capture.open_source import RowSource

        one = attrs.evolve(camera, width_px=camera.width_px // len(self.cameras))
        opened: list[FrameSource] = []
        try:
            for kind in self.cameras:
                opened.append(kind.open(one))
            return RowSource(opened, one.frame_px)
        except BaseException:
            for source in opened:
                source.close()
            raise


STREAMS = ("http", "https", "rtsp", "udp", "tcp")  # prefixes of network cameras
NETWORK = (
    "install a package with a source for it, as examples/lfpipe-example has for rtsp:, or feed a"
    " v4l2loopback device: `ffmpeg -i ADDRESS -f v4l2 /dev/video42`, then --camera camera:42"
)


KINDS: dict[str, type[SourceKind]] = {
    "camera": CameraSpec,
    "file": FileSpec,
    "demo": DemoSpec,
    "ring": RingKind,
    "row": RowKind,
}


def parse_source(text: str) -> SourceKind:
    """Parses text, without opening any file. Raises UserError that names the wrong part."""
    if text.isdecimal() or text.startswith("/dev/"):
        text = f"camera:{text}"
    prefix, _, rest = text.partition(":")
    source: SourceKind | None = None
    if prefix in KINDS:
        source = KINDS[prefix].parse(rest)
    elif prefix in plugins(SOURCES):
        kind: type[SourceKind] = load(SOURCES, prefix)
        IN_USE.append((SOURCES, prefix))
        with blaming([(SOURCES, prefix)]):
            source = kind.parse(rest)
    if source is None:
        *most, last = [
            *(kind.form for kind in KINDS.values()),
            *(f"{name}:..." for name in plugins(SOURCES)),
        ]
        forms = f"use one of {', '.join(most)}, or {last}"
        remedy = NETWORK if prefix in STREAMS else forms
        raise UserError(f"{redacted(text)!r}: not a frame source", remedy)
    return source


def playing_once(text: str) -> str:
    """The name of the source that plays once, unless text requests a loop.

    Raises UserError as `parse_source` does.
    """
    source = parse_source(text)
    if not isinstance(source, FileSpec) or source.names_loop:
        return text
    return f"{text}{'&' if '?' in text else '?'}loop=0"


def source_file(text: str) -> Path | None:
    """The file or folder that a source reads; None if it reads none, or is not a source."""
    with contextlib.suppress(UserError):
        if isinstance(source := parse_source(text), FileSpec):
            return source.path
    return None
