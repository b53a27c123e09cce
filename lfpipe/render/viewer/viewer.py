"""The viewer in front of the screen: from the position of the eyes to both viewpoints and the
picture.
"""

import math
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any, NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config
from lfpipe.config.camera_pose import CameraPose
from lfpipe.config.quality import thread_count
from lfpipe.eyes import (
    MAX_EYE_PX,
    MAX_PREDICTION_S,
    MIN_EYE_DISTANCE_PX,
    Eyes,
    EyesRecord,
    is_plausible_px,
    low_pass_gain,
    middle_of,
)
from lfpipe.files.codecs import fit_area
from lfpipe.render.synthesis.compositor import Compositor, Painters
from lfpipe.render.synthesis.viewpoint import Place, Position, ViewSolver
from lfpipe.render.viewer.geometry import Parallax, parallax
from lfpipe.render.viewer.presence import (
    ABSENT_S,
    Presence,
    RestingEyes,
    ViewEasing,
    ViewerState,
    idle_place,
)
from lfpipe.scene.lightfield import LightField
from lfpipe.transport.ring import SECOND_NS

# Time constants by which alpha, and the position in front of the screen, follow the viewer's
# distance (measured as the eye distance): fast for another distance, so that depth never stays
# beyond comfort; slow for measurement noise. The neutral position follows eyes that are still as
# fast before it is measured.
DISTANCE_S = 0.1
STILL_S = 1.0
STILL = 0.02
TRUSTED_S = 0.25  # after which the motion of a face that was just found is trusted
MOVED = 0.01  # change of the distance after which the views between the eyes are chosen again

# From a video's start to its first vblank, in refreshes. On 60, 75 and 144 Hz, frames of 24, 25 and
# 30 Hz begin at multiples of 1, 1/2 or 1/5 of a refresh (once 1/8, once 1/25): 0.3 keeps a tenth
# away from all vblanks. At a vblank, noise would choose the frame.
VIDEO_LEAD = 0.3

Size = tuple[int, int]  # (width, height), px


@attrs.frozen(kw_only=True)
class Canvas:
    """Where pictures are drawn: their size on the screen, and the threads."""

    shown_px: Callable[[Size], Size] = lambda size_px: size_px
    """The size at which a picture of a given size covers the screen, of the same aspect."""
    helpers: Executor | None = None
    """Threads on other cores, for parts of a large picture."""
    cores: int = 1
    """That may draw a picture."""
    gpu: Painters | None = None
    """Draws warped pictures in their place."""
    preparer: Executor | None = None
    """A thread that prepares pictures of another size or quality; None: they are prepared when they
    are due."""


CANVAS = Canvas()  # pictures of the light field's own size


class Viewpoints(NamedTuple):
    """The viewpoints of a picture."""

    eyes_px: Eyes
    """After filter and prediction."""
    left: Position
    """(row, col)."""
    right: Position
    """(row, col)."""
    frame: int
    """Of a video."""


class Viewer:
    """Holds the neutral position, alpha and the compositor; a changed configuration or scene keeps
    the position.

    Positions are px of the camera picture or, if the camera's pose is known, of the picture that a
    camera in the middle of the screen would take (`CameraPose`). All arithmetic uses plain numbers,
    which cost a tenth of numpy's small arrays.
    """

    def __init__(
        self,
        field: LightField,
        config: Config,
        share: float = 1.0,
        sways_alone: bool = False,
        neutral_is_fixed: bool = False,
        canvas: Canvas = CANVAS,
    ) -> None:
        """share: width of the pictures by that on the screen.
        sways_alone: the picture moves while there is no viewer. neutral_is_fixed: the neutral
        position is the middle of the camera picture, as for the mouse.
        """
        self._canvas = canvas
        self._next: Future[Compositor] | None = None  # in preparation
        self.parallax: Parallax | None = None
        # the mapping from eyes to views; None until a face was seen
        self.solver: ViewSolver | None = None
        self.presence = Presence()
        self._dragged = False  # whether the eyes drag the neutral position along
        self._centre_px: tuple[float, float] | None = None  # neutral position; None: no face yet
        self._eyes_px: Eyes = (0.0, 0.0, 0.0, 0.0)
        self._has_seen_face = False
        self._eye_distance_px = 0.0  # follows the distance slowly
        # the same, quickly, and at once for another face
        self._near_px = 0.0
        self._generation = 0
        self._t_ns = 0
        self._pose: CameraPose | None = None
        self._tracked_ns = -1  # stamp of the last record that presence processed
        self._start_ns = 0  # of a video
        self._sways_alone = sways_alone
        self._alone_ns = 0  # since when there is no viewer; 0: there is one
        # px per second of the raw eyes, by the last two frames of a track
        self._raw_px_s = (0.0, 0.0)
        self._raw: tuple[EyesRecord, int] | None = None  # the last frame with a face, its stamp
        self._track_ns = 0  # when its track began
        self._picture_mm: float | None = None
        self._neutral_is_fixed = neutral_is_fixed
        self.last_viewpoints: Viewpoints | None = None
        self.set(field, config, share)

    def set(
        self, field: LightField, config: Config, share: float = 1.0, completed: bool = False
    ) -> None:
        """Sets scene, configuration and share from the next viewpoints on. completed: it is the
        same scene, now with its disparity: viewpoint, neutral position and views between the eyes
        are kept, or eased.
        """
        if not completed:
            self.parallax = self.solver = None
            self._easing = ViewEasing()
            # whether alpha follows from the viewer's distance, instead of being given
            self._auto = isinstance(config.render.alpha_px, str)
            self._size_px = (0, 0)  # of the camera picture
        self.field, self.config, self._share = field, config, share
        self._next = None
        self._use(self._make_compositor(field, config, self._wanted_px()))
        if self.parallax is not None:
            self._choose(self._eye_distance_px)

    def replace(self, field: LightField) -> None:
        """Sets the next frame of a live scene: viewpoint and neutral position are kept."""
        self.field = field
        self.compositor.replace(field)
        if self.parallax is not None and self._auto:
            self._choose(self.parallax.eyes_px)

    def set_quality(self, config: Config, share: float = 1.0) -> None:
        """Sets a configuration that differs only in render.method and render.rate_hz, and a share:
        geometry stays unchanged.
        """
        before = self.config.render.method, self._share
        self.config, self._share = config, share
        if (config.render.method, share) != before:
            self._prepare()

    def update_compositor(self) -> bool:
        """Prepares a compositor if pictures cover another part of the screen; returns whether a new
        one is in use. Until it is ready, pictures keep their size.
        """
        if self._next is None and self._wanted_px() != self.compositor.size_px:
            self._prepare()
        if self._next is None or not self._next.done():
            return False
        self._use(self._next.result())
        self._next = None
        return True

    def full_picture(self) -> NDArray[np.uint8]:
        """The last picture at the light field's own size: uint8 (height, width, 3) BGR."""
        middle = (self.field.rows - 1) / 2, (self.field.cols - 1) / 2
        last = self.last_viewpoints or Viewpoints((0.0, 0.0, 0.0, 0.0), middle, middle, 0)
        return Compositor(self.field, self.config.render).compose(last.left, last.right, last.frame)

    def _wanted_px(self) -> Size:
        """The size of the next pictures."""
        own_px = self.field.width_px, self.field.height_px
        width = min(self._canvas.shown_px(own_px)[0], own_px[0]) * self._share
        return fit_area(own_px, (round(width), own_px[1]))[2:] if width < own_px[0] else own_px

    def _prepare(self) -> None:
        """Makes the next compositor beside the pictures in use."""
        arguments = self.field, self.config, self._wanted_px(), self.last_viewpoints
        if self._canvas.preparer is not None:
            self._next = self._canvas.preparer.submit(self._make_compositor, *arguments)
        else:
            self._use(self._make_compositor(*arguments))

    def _make_compositor(
        self, field: LightField, config: Config, size_px: Size, last: Viewpoints | None = None
    ) -> Compositor:
        canvas = self._canvas
        threads = thread_count(math.prod(size_px), canvas.cores)
        made = Compositor(field, config.render, canvas.helpers, threads, size_px, canvas.gpu)
        if last is not None:
            made.prepare(last.left, last.right, last.frame)
        return made

    def _use(self, compositor: Compositor) -> None:
        self.compositor = compositor
        if compositor.field is not self.field:  # of a live scene, while it was prepared
            compositor.replace(self.field)
        if self.solver is not None:
            self.solver.set_method(compositor.method)

    def eyes_mm(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """The left and the right eye at the last viewpoints, from the neutral place: right, up, and
        their distance from the screen, mm; zeros before the first face.
        """
        last, solver, parallax = self.last_viewpoints, self.solver, self.parallax
        if last is None or solver is None or parallax is None:
            return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        mm_per_px = self.config.screen.eyes_mm / parallax.eyes_px
        x, y = solver.centre_px
        lx, ly, rx, ry = last.eyes_px
        return (
            ((x - lx) * mm_per_px, (y - ly) * mm_per_px, parallax.distance_mm),
            ((x - rx) * mm_per_px, (y - ry) * mm_per_px, parallax.distance_mm),
        )

    def set_width(self, width_mm: float | None) -> bool:
        """Sets the width of the picture on the screen, as the display reports it; returns whether
        alpha must be chosen again.
        """
        before, self._picture_mm = self._picture_mm, width_mm
        is_new = width_mm != before and self.config.screen.width_mm == "auto"
        if is_new:
            self.parallax = self.solver = None
        return is_new

    def exchange(self, neutral_is_fixed: bool) -> None:
        """Prepares for another viewer."""
        self._neutral_is_fixed = neutral_is_fixed
        self._centre_px = self.solver = None

    def recentre(self) -> None:
        """Makes the last position of the eyes the neutral position."""
        if self._has_seen_face:
            self._centre_px = middle_of(self._eyes_px)
            self.solver = None

    def viewpoints(
        self, record: EyesRecord | None, t_sensor_ns: int, t_shown_ns: int, lead_ns: int = 0
    ) -> Viewpoints:
        """The viewpoints at t_shown_ns, from the newest eyes record and its frame's stamp; None
        before the first face. lead_ns: from a video's start to the time of its first picture.
        """
        frame = 0
        if self.field.frames > 1:
            self._start_ns = self._start_ns or t_shown_ns - lead_ns
            frame = video_frame(t_shown_ns, self._start_ns, self.field.frame_rate_hz)
        camera_px = (
            None
            if record is None or not record.face
            else _predicted(record, t_shown_ns - t_sensor_ns)
        )
        if record is None or (camera_px is None and not self._has_seen_face):
            row, col = (self.field.rows - 1) / 2, (self.field.cols - 1) / 2
            absent = record is None or _is_absent(t_sensor_ns, t_shown_ns)
            row, left_col, right_col = self._place_alone((row, col, col), t_shown_ns, absent)
            used_px, left, right = self._eyes_px, (row, left_col), (row, right_col)
        else:
            used_px, left, right = self._follow(record, camera_px, t_sensor_ns, t_shown_ns)
        self.last_viewpoints = Viewpoints(used_px, left, right, frame)
        return self.last_viewpoints

    def _follow(
        self, record: EyesRecord, camera_px: Eyes | None, t_sensor_ns: int, t_shown_ns: int
    ) -> tuple[Eyes, Position, Position]:
        """(eyes used, in px of the camera picture; left and right viewpoint)."""
        dt_s = max(t_shown_ns - self._t_ns, 0) / 1e9 if self._has_seen_face else 0.0
        self._t_ns = t_shown_ns
        if camera_px is not None:
            self._follow_distance(record, camera_px, dt_s)
        if self._size_px != (record.width_px, record.height_px):
            self._size_px = record.width_px, record.height_px
            self._pose = CameraPose.of(self.config, self._size_px)
        pose = self._pose
        eyes_px = camera_px
        if camera_px is not None and pose is not None:
            eyes_px = _flat(pose.from_screen(np.reshape(camera_px, (2, 2)), self._near_px))
        solver = self.solver or self._make_solver(eyes_px)
        if t_sensor_ns != self._tracked_ns:  # once per frame
            self._tracked_ns = t_sensor_ns
            self._follow_presence(record.generation, t_sensor_ns, solver, eyes_px)
            self._measure_motion(record, t_sensor_ns)
        self._has_seen_face = True
        if self._auto and self._centre_px is not None:
            self._follow_neutral(solver, self._centre_px, eyes_px, dt_s)
        if eyes_px is None:
            (x, y), half = solver.centre_px, self._eye_distance_px / 2
            neutral = solver.place((x + half, y, x - half, y))
            place = self._place_alone(neutral, t_shown_ns, _is_absent(t_sensor_ns, t_shown_ns))
            used_px = solver.eyes_at(place)
        else:
            self._alone_ns = 0
            self._eyes_px = used_px = eyes_px
            target = solver.place(eyes_px)
            place = self._easing.followed(t_shown_ns, target, self._explained)
            if place != target:
                used_px = solver.eyes_at(place)
        left, right = solver.positions(place)
        if pose is not None:
            used_px = _flat(pose.from_camera(np.reshape(used_px, (2, 2)), self._near_px))
        return used_px, left, right

    def _place_alone(self, neutral: Place, t_shown_ns: int, absent: bool) -> Place:
        """The place without a face, gliding to the neutral one; with sways_alone and no viewer,
        around it.
        """
        if self._sways_alone and (absent or self.presence.state is ViewerState.NOBODY):
            self._alone_ns = self._alone_ns or t_shown_ns
            t_s = (t_shown_ns - self._alone_ns) / 1e9
            neutral = idle_place(neutral, (self.field.rows, self.field.cols), t_s)
        return self._easing.alone(t_shown_ns, neutral)

    def _measure_motion(self, record: EyesRecord, t_sensor_ns: int) -> None:
        """Measures the speed of the raw eyes; filters lag behind it, or report none."""
        last, last_ns = self._raw or (record, t_sensor_ns)
        if self._raw is None or record.generation != last.generation:
            self._track_ns = t_sensor_ns
        self._raw = (record, t_sensor_ns) if record.face else None
        dt_s = (t_sensor_ns - last_ns) / 1e9
        self._raw_px_s = (0.0, 0.0)
        if record.face and dt_s > 0 and self._track_ns != t_sensor_ns:
            (x, y), (was_x, was_y) = middle_of(record.raw_px), middle_of(last.raw_px)
            self._raw_px_s = (x - was_x) / dt_s, (y - was_y) / dt_s

    def _explained(self, dt_s: float) -> Place:
        """Steps on the grid that the motion of the eyes explains in dt_s: none for a face that was
        just found, and none while the eyes drag the neutral position along.
        """
        assert self.solver is not None
        if self._raw is None or self._dragged or self._raw[1] - self._track_ns < TRUSTED_S * 1e9:
            return 0.0, 0.0, 0.0
        (u, v, p, q), (raw_u, raw_v) = self._raw[0].velocity_px_s, self._raw_px_s
        x = max((u + p) / 2, raw_u, key=abs) * dt_s
        y = max((v + q) / 2, raw_v, key=abs) * dt_s
        lx, ly, rx, ry = self._eyes_px
        now = self.solver.place(self._eyes_px)
        before = self.solver.place((lx - x, ly - y, rx - x, ry - y))
        return now[0] - before[0], now[1] - before[1], now[2] - before[2]

    def _follow_distance(self, record: EyesRecord, eyes_px: Eyes, dt_s: float) -> None:
        """Rejects impossible eye distances, which would persist in the running average."""
        eye_distance_px = record.eye_distance_px
        if not MIN_EYE_DISTANCE_PX <= eye_distance_px <= MAX_EYE_PX:
            # that in the picture
            eye_distance_px = max(math.dist(eyes_px[:2], eyes_px[2:]), MIN_EYE_DISTANCE_PX)
        if not self._has_seen_face:
            self._eye_distance_px = eye_distance_px
        if not self._has_seen_face or record.generation != self._generation:
            self._near_px = eye_distance_px
            self._generation = record.generation
        step_px = eye_distance_px - self._eye_distance_px
        still = abs(step_px) < STILL * self._eye_distance_px
        self._eye_distance_px += step_px * low_pass_gain(dt_s, STILL_S if still else DISTANCE_S)
        self._near_px += (eye_distance_px - self._near_px) * low_pass_gain(dt_s, DISTANCE_S)

    def _follow_presence(
        self, generation: int, t_sensor_ns: int, solver: ViewSolver, eyes_px: Eyes | None
    ) -> None:
        """Measures neutral position and distance when a viewer has come to rest."""
        here = None if eyes_px is None else RestingEyes(*middle_of(eyes_px), self._near_px)
        beyond = eyes_px is not None and solver.beyond(eyes_px)
        rest = self.presence.update(t_sensor_ns, here, generation, beyond)
        if rest is not None and self._auto and not self._neutral_is_fixed:
            self._centre_px = solver.centre_px = rest.x_px, rest.y_px
            self._choose(rest.eye_distance_px)

    def _follow_neutral(
        self, solver: ViewSolver, centre_px: tuple[float, float], eyes_px: Eyes | None, dt_s: float
    ) -> None:
        """Moves alpha with the distance; until a rest is measured, the grid follows the eyes and is
        centred on still ones.
        """
        assert self.parallax is not None
        if eyes_px is not None and abs(self._eye_distance_px / self.parallax.eyes_px - 1) > MOVED:
            self._choose(self._eye_distance_px)
        solver.alpha_px = self._eye_distance_px / self.parallax.views_between_eyes
        self._dragged = False
        moving = self.presence.state in (ViewerState.ARRIVING, ViewerState.EXCHANGED)
        if moving and eyes_px is not None and not self._neutral_is_fixed:
            before_px, centre_px = centre_px, solver.dragged(centre_px, eyes_px)
            self._dragged = centre_px != before_px
            if self.presence.settled:
                share = low_pass_gain(dt_s, DISTANCE_S)
                (cx, cy), (x, y) = centre_px, middle_of(eyes_px)
                centre_px = cx + (x - cx) * share, cy + (y - cy) * share
        self._centre_px = solver.centre_px = centre_px

    def _choose(self, eye_distance_px: float) -> None:
        """Chooses the views between the eyes for a viewer at the distance that eye_distance_px
        implies.
        """
        self.parallax = parallax(
            self.config, self.field, self._size_px[0], eye_distance_px, self._picture_mm
        )

    def _make_solver(self, eyes_px: Eyes | None) -> ViewSolver:
        """A fixed alpha centres the grid in the camera picture, as in the paper; alpha from
        geometry centres it on the viewer, who is never in the middle of a webcam above the screen.
        """
        self._choose(self._eye_distance_px)
        assert self.parallax is not None
        middle_px = self._size_px[0] / 2, self._size_px[1] / 2
        if self._auto and self._centre_px is None and eyes_px is not None:
            self._centre_px = middle_px if self._neutral_is_fixed else middle_of(eyes_px)
        self.solver = ViewSolver(
            self.field.rows,
            self.field.cols,
            self.config.render,
            self.parallax.alpha_px,
            self._centre_px or middle_px,
            self.compositor.method,
        )
        return self.solver


def _predicted(record: EyesRecord, prediction_ns: int) -> Eyes | None:
    """The eyes after prediction_ns, as `lfpipe.eyes.extrapolated`; None if impossible: a NaN would
    persist in the running averages.
    """
    s = min(max(prediction_ns, 0) / 1e9, MAX_PREDICTION_S)
    (lx, ly, rx, ry), (u, v, p, q) = record.filtered_px, record.velocity_px_s
    lx, ly, rx, ry = lx + u * s, ly + v * s, rx + p * s, ry + q * s
    return (lx, ly, rx, ry) if is_plausible_px(lx, ly, rx, ry) else None


def _flat(points: np.ndarray[Any, Any]) -> Eyes:
    lx, ly, rx, ry = points.ravel().tolist()
    return lx, ly, rx, ry


def _is_absent(t_sensor_ns: int, t_shown_ns: int) -> bool:
    """Whether the last frame is so old that the viewer counts as absent."""
    return t_shown_ns - t_sensor_ns > ABSENT_S * SECOND_NS


def video_frame(t_ns: int, start_ns: int, rate_hz: float) -> int:
    """The number of a video's frame at t_ns."""
    return int((t_ns - start_ns) * rate_hz / 1e9)
