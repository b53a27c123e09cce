"""The cameras of this machine, and the current device of one of them: device numbers change, name
and place do not. And a camera's exposure, gain and dynamic frame rate: applied at the start,
restored at the end.

Without Video4Linux, cameras have numbers only, written as the path /dev/videoN, and names if the
package cv2-enumerate-cameras is installed. A camera may take a second to answer, or never answer.
So a thread of its own asks it while frames are read.
"""

import contextlib
import errno
import logging
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, TypeVar

import attrs

from lfpipe import config
from lfpipe.capture.spec import CameraSpec
from lfpipe.capture.v4l2_device import DECODED, GREYS, ControlRange, V4L2Device
from lfpipe.errors import UserError
from lfpipe.files.safe_files import reason
from lfpipe.host import PORTABLE
from lfpipe.host.files import exists

log = logging.getLogger(__name__)
T = TypeVar("T")

# linux/v4l2-controls.h
AUTO_GAIN, GAIN = 0x00980912, 0x00980913
AUTO_EXPOSURE, EXPOSURE, DYNAMIC_FRAMERATE = 0x009A0901, 0x009A0902, 0x009A0903
CHECK_S = 2.0  # automatic exposure follows the light
RESTORE_TRIES = 3  # a busy camera misses a request; nobody would set the control again
DARKER = (
    "dynamic frame rate switched off until the end: in dim light the picture is darker instead of"
    " slower (camera.dynamic_framerate=auto leaves it on)"
)


# key: its control, steps per unit, unit,
# the control of its automatic, and that one's value for "manual"
AMOUNTS = {
    "camera.exposure": (EXPOSURE, 10, " ms", AUTO_EXPOSURE, 1),
    "camera.gain": (GAIN, 1, "", AUTO_GAIN, 0),
}


def control_texts(device: V4L2Device) -> list[str]:
    """The controls that the device has, with their present values and ranges, for people.

    Raises OSError as the driver does.
    """
    texts = []
    for key, (control, scale, unit, switch, manual) in AMOUNTS.items():
        if (span := device.control_range(control)) is not None:
            automatic = (
                device.control_range(switch) is not None and device.control(switch) != manual
            )
            value, low, high = (
                steps / scale for steps in (device.control(control), span.minimum, span.maximum)
            )
            texts.append(
                f"{key} {value:g}{unit}{' (automatic)' if automatic else ''} [{low:g} to"
                f" {high:g}{unit}]"
            )
    if device.control_range(DYNAMIC_FRAMERATE) is not None:
        texts.append(f"camera.dynamic_framerate {device.control(DYNAMIC_FRAMERATE)} [0 to 1]")
    return texts


class CameraControls(threading.Thread):
    """Applies the configuration to a device, then asks it every CHECK_S; at the end restores the
    old settings and closes it.

    notes: for the user, by key, complete once `applied` is set. exposure_ns: as the camera reports
    it, None if it does not.
    signal: False if nothing is connected to the device's input.
    """

    def __init__(self, device: V4L2Device, camera: config.Camera) -> None:
        """device: open; it belongs to the thread from now on."""
        super().__init__(name="camera-controls", daemon=True)
        self._device = device
        self._camera = camera
        self._before: dict[int, int] = {}
        self._ending = threading.Event()
        self.applied = threading.Event()
        self.notes: dict[str, str] = {}
        self.exposure_ns: int | None = None
        self.signal = True
        self.start()

    def run(self) -> None:
        try:
            self._apply(self._camera)
            while True:
                self.exposure_ns = self._attempt("", self._exposure_ns)
                self.signal = self._device.signal
                self.applied.set()
                if self._ending.wait(CHECK_S):
                    break
            for control, value in reversed(self._before.items()):
                any(
                    self._attempt("", self._set, control, value) is not None
                    for _ in range(RESTORE_TRIES)
                )
        finally:
            self.applied.set()
            self._device.close()

    def end(self, wait_s: float) -> None:
        """Restores every changed control, the last one first, as far as the device answers
        in time.
        """
        self._ending.set()
        self.join(wait_s)

    def _apply(self, camera: config.Camera) -> None:
        for key, value in ("camera.exposure", camera.exposure), ("camera.gain", camera.gain):
            if value != "auto":
                self._attempt(key, self._set_amount, key, value)
        key = "camera.dynamic_framerate"
        state = camera.dynamic_framerate
        if (
            state != "auto"
            and self._attempt(key, self._set, DYNAMIC_FRAMERATE, int(state == "on"))
            and state == "off"
        ):
            self.notes[key] = DARKER

    def _attempt(self, key: str, call: Callable[..., T | None], *args: Any) -> T | None:
        """The device's answer; if it fails None, which is noted for the key."""
        try:
            return call(*args)
        except OSError as error:
            log.info("camera control failed: %s %s", key, reason(error))
            if key:
                self.notes[key] = f"{key}: the camera does not take it ({reason(error)})"
            return None

    def _set(self, control: int, value: int) -> bool | None:
        """Sets a control to a value in its range.

        Returns whether that changed it; None if the device has no such value.
        """
        span = self._device.control_range(control)
        if span is None or not span.minimum <= value <= span.maximum:
            return None
        before = self._device.control(control)
        if before != value:
            self._device.set_control(control, value)
            self._before.setdefault(control, before)
        return before != value

    def _set_amount(self, key: str, value: float) -> None:
        """Sets one of AMOUNTS to the nearest value that it has, and notes how that differs."""
        control, scale, unit, switch, manual = AMOUNTS[key]
        self._set(switch, manual)
        if (span := self._device.control_range(control)) is None:
            self.notes[key] = f"{key} = {value:g}{unit}: the camera has no such control"
            return
        nearest = _nearest(span, value * scale)
        self._set(control, nearest)
        if abs(nearest - value * scale) > max(span.step, 1) / 2:
            low, high = span.minimum / scale, span.maximum / scale
            self.notes[key] = (
                f"{key} = {value:g}{unit}: using {nearest / scale:g} ({low:g} to {high:g}{unit}"
                " possible)"
            )

    def _exposure_ns(self) -> int | None:
        if self._device.control_range(EXPOSURE) is None:
            return None
        return self._device.control(EXPOSURE) * 100_000 or None  # it counts 0.1 ms


def _nearest(span: ControlRange, value: float) -> int:
    """The value in a range that is nearest to another one."""
    steps = round((value - span.minimum) / span.step)
    last = (span.maximum - span.minimum) // span.step
    return span.minimum + min(max(steps, 0), last) * span.step


SYS, DEV = Path("/sys/class/video4linux"), Path("/dev")
ANSWER_S = 3.0  # drivers answer in microseconds; a stuck one never does
START_S = 5.0  # longest wait for the first frame: some cameras need seconds
LIST_S = 30.0  # thousands of calls on an emulated machine
WITHOUT_CAMERA = "plug it in, or use --camera demo, or a recording with --camera file:PATH"
LIBCAMERA = (
    "feed a v4l2loopback device from libcamera, for example with "
    "`gst-launch-1.0 libcamerasrc ! videoconvert ! v4l2sink device=/dev/video42`"
)

log = logging.getLogger(__name__)


@attrs.frozen
class CameraDevice:
    """A listed device; texts are empty if unknown."""

    path: Path
    name: str = ""
    """The driver's."""
    place: str = ""
    """Its path in /sys, which names the port."""


def with_time_limit(limit_s: float, call: Callable[[], T]) -> T:
    """Returns the result of call, or raises its error. Raises OSError ETIMEDOUT (TimeoutError)
    after limit_s; the thread of the call then stays until the process ends, because nothing can end
    it.
    """
    result: Future[T] = Future()

    def run() -> None:
        try:
            result.set_result(call())
        except BaseException as error:  # raised in the caller's thread
            result.set_exception(error)

    threading.Thread(target=run, name="time-limit", daemon=True).start()
    try:
        return result.result(limit_s)
    except TimeoutError:
        raise TimeoutError(errno.ETIMEDOUT, f"no answer for {limit_s:g} s") from None


def opened(path: Path) -> V4L2Device:
    """The device. Raises OSError as the driver does, ETIMEDOUT after ANSWER_S."""
    return with_time_limit(ANSWER_S, lambda: V4L2Device(path))


def asking(path: Path, question: Callable[[V4L2Device], T], limit_s: float = LIST_S) -> T:
    """Opens the device, queries it and closes it. Raises OSError from the driver, ETIMEDOUT after
    limit_s, ENOTSUP without Video4Linux.
    """
    if PORTABLE:
        raise OSError(errno.ENOTSUP, "OpenCV lists no formats", path)

    def ask() -> T:
        with contextlib.closing(V4L2Device(path)) as device:
            return question(device)

    return with_time_limit(limit_s, ask)


def nodes() -> list[CameraDevice]:
    """Every video device by number, cameras or not. Opens none of them."""
    if PORTABLE:
        try:
            from cv2_enumerate_cameras import enumerate_cameras
        except ImportError:
            return []
        names = {camera.index: camera.name for camera in enumerate_cameras()}
        return [
            CameraDevice(Path(f"/dev/video{number}"), name)
            for number, name in sorted(names.items())
        ]
    devices = []
    for entry in sorted(
        SYS.glob("video*"), key=lambda entry: int("0" + entry.name.removeprefix("video"))
    ):
        with contextlib.suppress(OSError):  # unplugged meanwhile
            place = str((entry / "device").resolve(strict=True))
            devices.append(
                CameraDevice(DEV / entry.name, (entry / "name").read_text().strip(), place)
            )
    return devices


def describe(path: Path) -> CameraDevice:
    """The device at path with its name and place."""
    by_path = {device.path: device for device in nodes()}
    return attrs.evolve(by_path.get(path.resolve(), CameraDevice(path)), path=path)


def _captures(device: CameraDevice) -> bool:
    """Whether a node delivers pictures; True if it cannot be queried (busy, no permission) but is
    there.
    """
    try:
        return asking(device.path, lambda opened_device: opened_device.captures, ANSWER_S)
    except OSError as error:
        return PORTABLE or isinstance(error, PermissionError) or exists(device.path)


def cameras() -> list[CameraDevice]:
    """The capturing devices, by number.

    Includes devices that cannot be queried (busy, no permission).
    """
    return [device for device in nodes() if _captures(device)]


def others(path: Path = Path()) -> str:
    """A remedy for a missing camera: the other cameras, or alternatives without one; names
    libcamera if only its cameras are here.
    """
    if listed := ", ".join(
        f"camera:{camera.path} ({camera.name})" for camera in cameras() if camera.path != path
    ):
        return f"use one of the available cameras: {listed}"
    for node in nodes():
        try:
            if asking(node.path, lambda device: device.multi_planar, ANSWER_S):
                return f"{LIBCAMERA}: {node.path} ({node.name}) is multi-planar"
        except OSError:
            continue
    return WITHOUT_CAMERA


class NoCamera(UserError):
    """Raised if the first camera is requested and there is none: a session continues with the
    mouse.
    """


def _formats(device: CameraDevice) -> Sequence[str] | None:
    try:
        return asking(device.path, lambda opened_device: opened_device.fourccs(), ANSWER_S)
    except OSError:
        return None


def ranked(
    devices: Sequence[CameraDevice],
    formats: Callable[[CameraDevice], Sequence[str] | None] = _formats,
) -> list[tuple[CameraDevice, str]]:
    """Cameras, the best to see a face with first, then by their USB ports, which stay when numbers
    change; and why another one is better, "" for the best ones. formats: the pixel formats of one;
    None if it cannot be asked.
    """
    doubts = [(device, _doubt(formats(device))) for device in devices]
    return sorted(doubts, key=lambda one: (DOUBTS.index(one[1]), one[0].place))


UNKNOWN = "its formats are not known"
GREY_ONLY = "grey pictures only, as of the infrared camera of a face login"
UNDECODABLE = "no picture that can be decoded"
DOUBTS = ("", UNKNOWN, GREY_ONLY, UNDECODABLE)


def _doubt(formats: Sequence[str] | None) -> str:
    if not formats:
        return UNKNOWN
    decoded = [name for name in formats if name in DECODED]
    if not decoded:
        return UNDECODABLE
    return GREY_ONLY if all(name in GREYS for name in decoded) else ""


def first_camera() -> CameraSpec:
    """The best camera to see a face with. Raises NoCamera."""
    best_first = ranked(cameras())
    if not best_first:
        raise NoCamera("no camera found", others())
    for device, doubt in best_first[1:]:
        log.info("camera %s is not used: %s", device.path, doubt or "it is not the first")
    return CameraSpec(best_first[0][0].path)


def by_name(name: str, devices: list[CameraDevice]) -> CameraDevice:
    """The device with this name, ignoring case, else the one whose name contains it.

    Raises UserError for none or several.
    """
    folded = name.casefold()
    named = [d for d in devices if d.name.casefold() == folded] or [
        d for d in devices if folded in d.name.casefold()
    ]
    if not named:
        raise UserError(f"camera:{name}: no camera with that name", others())
    if len(named) > 1:
        named = [device for device in named if _captures(device)] or named
    if len(named) > 1:
        paths = " or ".join(f"camera:{device.path}" for device in named)
        raise UserError(f"camera:{name}: {len(named)} cameras have that name", f"use {paths}")
    return named[0]


class CameraFinder:
    """Follows one camera through changes of its device number.

    It is recognised by its name and its place (the USB port). At another place, a device of that
    name is the same camera only if it came after the first one had gone: another camera of the same
    model that was connected all the time never takes over.
    """

    def __init__(self, spec: CameraSpec) -> None:
        self._spec = spec
        self._device: CameraDevice | None = None  # as it was last
        self._twins: set[str] = set()  # places of other cameras of that name
        self._gone = False

    def path(self) -> Path:
        """The camera's device file now.

        Raises UserError if no camera, or more than one, has the name, or if it is unplugged.
        """
        before = self._device
        if before is None:
            spec = self._spec if self._spec != CameraSpec() else first_camera()
            first = by_name(spec.name, nodes()) if spec.name else describe(spec.path)
            if first.place:  # else there is nothing to recognise it by
                self._device = first
            return first.path
        same_name = [device for device in nodes() if device.name == before.name]
        same_place = [device for device in same_name if device.place == before.place]
        if same_place or not self._gone:
            self._twins = {device.place for device in same_name} - {before.place}
        self._gone = not same_place
        candidates = same_place or [
            device for device in same_name if device.place not in self._twins
        ]
        candidates.sort(key=lambda device: device.path != before.path)
        # nodes of one camera (pictures, metadata) share name and place,
        # and may have swapped their numbers
        current = next((device for device in candidates if _captures(device)), None)
        if current is None:
            raise UserError(f"camera {before.path} ({before.name}): unplugged", "plug it in again")
        if current.path != before.path:
            log.info("camera %s is now %s", before.path, current.path)
        self._device = current
        self._gone = False
        return current.path
