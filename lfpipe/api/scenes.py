"""In a notebook: opens light fields from files and arrays, and renders any view; finds eyes in
pictures, by the session's tracking without a session.

Of arguments of the wrong type, a TypeError names the parameter.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import attrs
import numpy as np
from beartype import BeartypeConf, beartype
from numpy.typing import NDArray

from lfpipe.config import Config, Scene, updated
from lfpipe.errors import UserError
from lfpipe.eyes import EYES, extrapolated
from lfpipe.files.safe_files import replaced
from lfpipe.host.files import is_file
from lfpipe.render.synthesis.compositor import Compositor, ViewRenderer
from lfpipe.scene import pack
from lfpipe.scene.layouts.arrays import require_views
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import cache_dir, named_scene
from lfpipe.supervisor.process_table import SCORER
from lfpipe.track.eye_tracker import EyeTracker, Head, HeadEstimator

if TYPE_CHECKING:
    from numpy.typing import ArrayLike as ArrayLike

    Number: TypeAlias = float
    WholeNumber: TypeAlias = int
else:  # what is accepted when it runs: numbers of numpy, and for arrays whatever `numbers` accepts
    ArrayLike = object
    WholeNumber = int | np.integer
    Number = float | np.floating | WholeNumber

typed = beartype(
    conf=BeartypeConf(is_color=False, is_pep484_tower=True, violation_param_type=TypeError)
)


def numbers(name: str, value: Any) -> NDArray[Any]:
    """value as an array. Raises TypeError that names the parameter if it has no numbers."""
    try:
        array = np.asarray(value)
    except ValueError as error:  # rows of several lengths
        raise TypeError(f"{name} must be an array: {error}") from None
    if array.dtype.kind not in "buif":
        what = f"an array of {array.dtype}" if array.ndim else type(value).__name__
        raise TypeError(f"{name} must be an array of numbers, not {what}")
    return array


KEPT_S = 7 * 86400.0  # arrays that nobody has opened for so long are removed from the cache
ScenePath = str | os.PathLike[str]


@typed
def open_scene(
    scene: ScenePath | LightField | ArrayLike | None = None,
    settings: Mapping[str, Any] | None = None,
    *,
    disparity: ArrayLike | None = None,
    positions: ArrayLike | None = None,
    invert_depth: bool | None = None,
) -> LightField:
    """Opens a light field.

    The first call packs it into the cache, which may take a minute; later calls return at once.

    Parameters
    ----------
    scene : path, LightField or array_like, optional
        A folder or file in any layout that lfpipe reads; an open light field, which is opened once
        more; or an array (rows, cols, height, width, 1 or 3), red first, perhaps with frames before
        these axes: uint8, uint16 or float from 0 to 1. Row 0 is the top row of cameras, column 0
        the left one. By default the demo's scene.
    settings : mapping, optional
        As for `--set`, for example {"scene.layout": "hci"}.
    disparity : array_like, (rows, cols, height, width), optional
        Only with an array: px per view, larger is nearer. Used where it predicts the views better
        than optical flow.
    positions : array_like, (rows, cols, 2), optional
        Only with an array: (down, right) of each camera, in steps of the grid.
    invert_depth : bool, optional
        Whether to invert the depth; by default it is detected.

    Returns
    -------
    LightField

    Raises
    ------
    UserError
        If it is no light field, or cannot be read.
    TypeError
        For an argument of another type.

    Examples
    --------
    >>> import numpy as np
    >>> views = np.random.default_rng(0).integers(0, 256, (1, 3, 48, 64, 3), np.uint8)
    >>> with open_scene(views) as field:
    ...     render_view(field, 0, 1.5).shape
    (48, 64, 3)
    """
    config = updated(Config(), settings or {}).scene
    if invert_depth is not None:
        config = attrs.evolve(config, invert_depth="yes" if invert_depth else "no")
    return pack.open_scene(
        scene_path(scene, config, disparity=disparity, positions=positions), config, scorer=SCORER
    )


def scene_path(
    scene: ScenePath | LightField | ArrayLike | None,
    config: Scene,
    *,
    disparity: ArrayLike | None = None,
    positions: ArrayLike | None = None,
) -> Path | None:
    """The path of a scene, the pack of an open light field; an array is written to the cache, by
    its content. Raises UserError.
    """
    extras = {
        name: numbers(name, value)
        for name, value in (("disparity", disparity), ("positions", positions))
        if value is not None
    }
    if isinstance(scene, LightField):
        scene = Path(scene.folder)
    if scene is None or isinstance(scene, str | os.PathLike):
        if extras:
            raise UserError(
                f"{scene or 'the demo'}: only arrays have {', '.join(extras)}", "leave them out"
            )
        return None if scene is None else named_scene(Path(scene), cache_dir(config))
    views = numbers("scene", scene)
    if views.ndim == 6 and views.shape[3] in (1, 3) and views.shape[-1] > 3:
        raise UserError(
            f"the array has its planes before height and width: {views.shape}",
            "put them last with np.moveaxis(views, 3, -1)",
        )
    require_views(views, "the array")
    arrays = {
        "views": np.ascontiguousarray(views),
        **{name: np.ascontiguousarray(value) for name, value in extras.items()},
    }
    digest = hashlib.sha256()
    for name, array in arrays.items():
        digest.update(f"{name} {array.shape} {array.dtype.str};".encode())
        digest.update(array.data)
    folder = cache_dir(config) / "arrays"
    path = folder / f"array-{digest.hexdigest()[:20]}{'.npz' if extras else '.npy'}"
    try:
        folder.mkdir(0o700, parents=True, exist_ok=True)
        if is_file(path):
            return path
        for old in folder.glob(f"array-{'[0-9a-f]' * 20}.np[yz]"):
            if time.time() - old.lstat().st_atime > KEPT_S:  # noqa: TID251 - a date
                old.unlink(missing_ok=True)
        with replaced(path) as file:
            if extras:
                np.savez(file, **arrays)  # type: ignore[arg-type]
            else:
                np.save(file, arrays["views"])
    except OSError as error:
        raise UserError(
            f"{path}: {error.strerror}", "free some space, or name another folder: scene.cache_dir"
        ) from None
    return path


@typed
def render_view(
    field: LightField,
    row: Number,
    col: Number,
    *,
    method: str = "auto",
    frame: WholeNumber = 0,
    order: str = "bgr",
) -> NDArray[np.uint8]:
    """The view of a camera on the grid.

    Parameters
    ----------
    field : LightField
    row, col : float
        (0, 0) is the top left camera; fractions lie between views. Positions outside the grid are
        extrapolated by up to `render.extrapolate_views`.
    method : str
        auto, nearest, blend, warp or warp2.
    frame : int
        Of a light-field video.
    order : str
        Of the channels: "bgr", as OpenCV has them, or "rgb", as Matplotlib and Pillow have them.

    Returns
    -------
    ndarray of uint8, (height, width, 3)

    Raises
    ------
    UserError
        For a position, a frame or a value that does not exist.
    TypeError
        For an argument of another type.
    """
    config = updated(Config(), {"render.method": method})
    _check(field, (row, col), config.render.extrapolate_views, frame)
    return _ordered(ViewRenderer(field, method).render(row, col, frame), order)


@typed
def render_anaglyph(
    field: LightField,
    left: tuple[Number, Number],
    right: tuple[Number, Number],
    *,
    mode: str = "dubois",
    frame: WholeNumber = 0,
    settings: Mapping[str, Any] | None = None,
    order: str = "bgr",
) -> NDArray[np.uint8]:
    """The picture for two eyes.

    Parameters
    ----------
    field : LightField
    left, right : tuple of float
        (row, col) of the eyes on the grid.
    mode : str
        As `render.anaglyph`, including side-by-side.
    frame : int
        Of a light-field video.
    settings : mapping, optional
        Of `render`, for example {"render.zero_plane_px": 0.5}.
    order : str
        Of the channels: "bgr" or "rgb".

    Returns
    -------
    ndarray of uint8, (height, width, 3)

    Raises
    ------
    UserError
        For a position, a frame or a value that does not exist.
    TypeError
        For an argument of another type.
    """
    render = updated(Config(), {"render.anaglyph": mode, **(settings or {})}).render
    for place in (left, right):
        _check(field, place, render.extrapolate_views, frame)
    return _ordered(Compositor(field, render).compose(left, right, frame).copy(), order)


def _ordered(picture: NDArray[np.uint8], order: str) -> NDArray[np.uint8]:
    """A BGR picture with its channels in an order. Raises UserError."""
    if order not in ("bgr", "rgb"):
        raise UserError(f"order {order!r}: not an order of channels", 'use "bgr" or "rgb"')
    return picture if order == "bgr" else np.ascontiguousarray(picture[..., ::-1])


def _check(field: LightField, place: tuple[float, float], beyond: float, frame: int) -> None:
    if not 0 <= frame < field.frames:
        raise UserError(
            f"frame {frame}: the scene has {field.frames} frames", f"use 0 to {field.frames - 1}"
        )
    for name, value, count in zip(("row", "col"), place, (field.rows, field.cols), strict=True):
        if not -beyond <= value <= count - 1 + beyond:
            raise UserError(
                f"{name} {value:g}: the scene has {count} views that way",
                f"use 0 to {count - 1}, or at most {beyond:g} beyond it",
            )


@attrs.frozen(eq=False, kw_only=True)
class Eyes:
    """A viewer's eyes in one frame.

    Positions are [[left x, y], [right x, y]] of the viewer's own eyes, in px of the unmirrored
    picture.
    """

    t_ns: int
    """Time of the frame."""
    raw_px: NDArray[np.float64]
    """(2, 2), as measured."""
    filtered_px: NDArray[np.float64]
    """(2, 2), smoothed."""
    velocity_px_s: NDArray[np.float64]
    """(2, 2)."""
    confidence: float
    """0 to 1."""
    head: Head | None
    """In mm before the screen, see `track.eye_tracker`; None for an impossible eye distance."""

    @classmethod
    def of(cls, record: NDArray[np.void], t_ns: int, head: Head | None) -> Eyes | None:
        """Converts a record of dtype EYES; None without a face."""
        if not record["face"]:
            return None
        raw_px, filtered_px, velocity_px_s = (
            record[name].copy() for name in ("raw_px", "filtered_px", "velocity_px_s")
        )
        return cls(
            t_ns=t_ns,
            raw_px=raw_px,
            filtered_px=filtered_px,
            velocity_px_s=velocity_px_s,
            confidence=float(record["confidence"]),
            head=head,
        )

    def predicted_px(self, t_ns: int) -> NDArray[np.float64]:
        """The predicted eyes.

        Parameters
        ----------
        t_ns : int
            On the clock of `t_ns`. Times more than a quarter of a second ahead count as that.

        Returns
        -------
        ndarray of float, (2, 2)
            px.
        """
        return extrapolated(self.filtered_px, self.velocity_px_s, t_ns - self.t_ns)


class Closing:
    """A context that closes the object at its end."""

    close: Callable[[], None]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Tracker(Closing):
    """Tracks one face from frame to frame, in this process.

    Parameters
    ----------
    settings : mapping, optional
        Of `track` and `camera`, for example {"track.filter": "one-euro"}.

    Raises
    ------
    UserError
        For wrong settings, and if the networks of the engine are missing.

    Examples
    --------
    >>> import numpy as np
    >>> with Tracker() as tracker:
    ...     print(tracker.update(np.zeros((480, 640, 3), np.uint8)))
    None
    """

    @typed
    def __init__(self, settings: Mapping[str, Any] | None = None) -> None:
        config = updated(Config(), settings or {})
        self._tracker = EyeTracker(config.track)
        self._estimator = HeadEstimator(config)
        self._record = np.zeros((), EYES)
        self._closed = False

    def update(self, frame: NDArray[Any], t_ns: int | None = None) -> Eyes | None:
        """The eyes in the next frame.

        Parameters
        ----------
        frame : ndarray of uint8, (height, width, 3)
            BGR, not mirrored.
        t_ns : int, optional
            Its time on any clock that never goes back; by default the monotonic clock's now.

        Returns
        -------
        Eyes or None
            None without a face.

        Raises
        ------
        UserError
            For anything but such a picture, and after `close`.
        """
        if self._closed:
            raise UserError("this Tracker is closed", "make a new one")
        is_array = isinstance(frame, np.ndarray)
        if (
            not is_array
            or frame.dtype != np.uint8
            or frame.ndim != 3
            or frame.shape[2] != 3
            or not frame.size
        ):
            what = f"{frame.dtype} {frame.shape}" if is_array else type(frame).__name__
            raise UserError(
                f"{what}: not a picture",
                "give uint8 (height, width, 3), blue first; cv2.cvtColor turns grey into colour",
            )
        t_ns = time.monotonic_ns() if t_ns is None else t_ns
        tracker = self._tracker
        tracker.update(tracker.engine.detect(frame), t_ns)
        tracker.write(self._record, frame)
        self._estimator.update(self._record, t_ns)
        tracker.engine.examine(frame)
        return Eyes.of(self._record, t_ns, self._estimator.head(self._record))

    def reset(self) -> None:
        """Forgets the current face."""
        self._tracker.reset()

    def close(self) -> None:
        """Releases the engine. May be called again."""
        if not self._closed:
            self._closed = True
            self._tracker.engine.close()
