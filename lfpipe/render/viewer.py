"""The viewer before the screen: from the position of the eyes to the two viewpoints and the picture."""

import math
from collections.abc import Hashable

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config
from lfpipe.config.camera_pose import EYES_MM, CameraPose
from lfpipe.eyes import extrapolated
from lfpipe.render.compositor import Compositor
from lfpipe.render.easing import EyeEasing
from lfpipe.render.geometry import LEAST_EYES_PX, Parallax, alpha_is_automatic, parallax
from lfpipe.render.idle_motion import IdleMotion
from lfpipe.render.presence import ABSENT_S, Presence, Rest, ViewerState
from lfpipe.render.viewpoint import Position, ViewSolver
from lfpipe.scene.lightfield import LightField

FAR_PX = 1e6  # outside the picture's corner; no eye is further out
# Time constants by which alpha follows the viewer's distance, seen as the distance between the eyes: quickly to another distance,
# so that depth never stays beyond comfort; slowly where the difference is the noise of a measurement.
DISTANCE_S, STILL_S, STILL = 0.25, 1.0, 0.02
NEUTRAL_S = 0.5  # time constant of changes of the neutral position
POSE_S = 0.1  # time constant of the distance that gives the position before the screen
MOVED = 0.01  # change of the distance after which the views between the eyes are chosen again

# From a video's start to its first blank, in refreshes. On 60, 75 and 144 Hz, frames of 24, 25 and 30 Hz begin at multiples of 1,
# 1/2 or 1/5 of a refresh (once 1/8, once 1/25): 0.3 keeps a tenth away from all blanks. At a blank, noise would choose the frame.
VIDEO_LEAD = 0.3


@attrs.frozen(eq=False)
class Viewpoints:
    """The viewpoints of a picture. eyes_px: (2, 2), after filter and prediction. left, right: (row, col). frame: of a video."""

    eyes_px: NDArray[np.float64]
    left: Position
    right: Position
    frame: int


class Viewer:
    """Holds the neutral position, alpha and the compositor; a changed configuration or scene keeps the position.

    Positions are px of the camera picture; where the camera's pose is known, of the picture that a camera in the middle of the
    screen would take (`CameraPose`).
    """

    def __init__(self, field: LightField, config: Config, exhibition: bool = False) -> None:
        """exhibition: the picture moves while nobody is there."""
        self.parallax: Parallax | None = None
        self.presence = Presence()
        self._target_px: NDArray[np.float64] | None = None  # neutral position; None: not measured
        self._centre_px: NDArray[np.float64] | None = None  # the same, while moving there
        self._eyes_px = np.zeros((2, 2))
        self._seen = False
        self._apart_px = 0.0  # follows the distance slowly
        self._near_px, self._generation = 0.0, 0  # the same, quickly, and at once for another face
        self._eyes_mm = 0.0
        self._t_ns = 0
        self._size_px = (0, 0)  # of the camera picture
        self._tracked_ns = -1  # stamp of the last record that presence processed
        self._start_ns = 0
        # Start of a video before the time of the first picture: half a refresh of a screen. If the video's rate divides the
        # screen's, times then lie well within its frames, and jitter of the clock never repeats or skips one.
        self.video_lead_ns = 0
        self._easing = EyeEasing()
        self._idle = IdleMotion() if exhibition else None
        self._shown_mm: float | None = None
        self.neutral_is_fixed = False  # the viewer is the mouse, which says itself where the neutral position is
        self.shown: Viewpoints | None = None  # the last viewpoints
        self.set(field, config)

    def set(self, field: LightField, config: Config) -> None:
        """Sets scene and configuration from the next viewpoints on."""
        self.field, self.config = field, config
        self.compositor = Compositor(field, config.render)
        self.parallax = None
        self._solver: ViewSolver | None = None

    def complete(self, field: LightField, config: Config) -> None:
        """Sets the same scene, now with its disparity: viewpoint, neutral position and views between the eyes stay, or follow."""
        self.field = field
        self.redraw_by(config)
        if self.parallax is not None:
            self._choose(self._apart_px)

    def redraw_by(self, config: Config) -> None:
        """Sets a configuration that differs only in render.method and render.rate_hz: geometry stays unchanged."""
        self.config, self.compositor = config, Compositor(self.field, config.render)
        if self._solver is not None:
            self._solver.draw_with(self.method)

    def shown_as_wide(self, width_mm: float | None) -> bool:
        """Sets the width of the picture on the screen, as the display reports it; returns whether alpha must be chosen again."""
        new = width_mm != self._shown_mm and self.config.screen.width_mm == "auto"
        self._shown_mm = width_mm
        if new:
            self.parallax = self._solver = None
        return new

    @property
    def method(self) -> str:
        return self.compositor.method

    @property
    def solver(self) -> ViewSolver | None:
        """The mapping from eyes to views; None until a face was seen."""
        return self._solver

    @property
    def _auto(self) -> bool:
        return alpha_is_automatic(self.config)

    def recentre(self) -> None:
        """Makes the last position of the eyes the neutral position."""
        if self._seen:
            self._target_px = self._centre_px = self._eyes_px.mean(axis=0)
            self._solver = None

    def viewpoints(self, record: NDArray[np.void] | None, t_sensor_ns: int, t_shown_ns: int) -> Viewpoints:
        """The viewpoints at t_shown_ns, from the newest eyes record and its frame's stamp; None if nobody was seen yet."""
        frame = self._frame(t_shown_ns)
        camera_px = None if record is None else self._eyes(record, t_shown_ns - t_sensor_ns)
        if record is None or (camera_px is None and not self._seen):
            row, col = (self.field.rows - 1) / 2, (self.field.cols - 1) / 2
            self.shown = Viewpoints(self._eyes_px, *self._swayed((row, col), (row, col), t_shown_ns, t_sensor_ns), frame)
            return self.shown
        dt_s = max(t_shown_ns - self._t_ns, 0) / 1e9 if self._seen else 0.0
        self._t_ns = t_shown_ns
        if camera_px is not None:
            self._follow_distance(float(record["apart_px"]), math.dist(*camera_px.tolist()), dt_s, int(record["generation"]))
        if float(record["eyes_mm"]) != self._eyes_mm:  # learnt for the first time or again
            self._eyes_mm, self._solver = float(record["eyes_mm"]), None
        pose = self._pose(record)
        eyes_px = camera_px if camera_px is None or pose is None else pose.from_screen(camera_px, self._near_px)
        solver = self._solver or self._make_solver(eyes_px)
        self._follow_presence(record, t_sensor_ns, solver, eyes_px)
        half = self._apart_px / 2
        neutral_px = np.add(solver.centre_px, [[half, 0.0], [-half, 0.0]])
        start_px = neutral_px if self._seen or eyes_px is None else eyes_px  # no easing for the first face
        self._seen = True
        self._eyes_px = self._easing.at(t_shown_ns, eyes_px, start_px, int(record["generation"]), solver.alpha_px)
        self._follow_neutral(solver, None if eyes_px is None else self._eyes_px, dt_s)
        left, right = self._swayed(*solver.views(self._eyes_px), t_shown_ns, t_sensor_ns)
        used_px = self._eyes_px if pose is None else pose.from_camera(self._eyes_px, self._near_px)
        self.shown = Viewpoints(used_px, left, right, frame)
        return self.shown

    def _swayed(self, left: Position, right: Position, t_ns: int, t_sensor_ns: int) -> tuple[Position, Position]:
        """The viewpoints; moving while an exhibition has no viewer or no camera."""
        if self._idle is None:
            return left, right
        alone = self.presence.state is ViewerState.NOBODY or t_ns - t_sensor_ns > ABSENT_S * 1e9
        return self._idle.moved(left, right, (self.field.rows, self.field.cols), t_ns, alone, self.method == "nearest")

    def key(self, viewpoints: Viewpoints) -> Hashable:
        """Equal keys mean the same picture."""
        return self.compositor.key(viewpoints.left, viewpoints.right, viewpoints.frame)

    def compose(self, viewpoints: Viewpoints) -> NDArray[np.uint8]:
        """The picture, uint8 (height, width, 3) BGR, valid until the next call."""
        return self.compositor.compose(viewpoints.left, viewpoints.right, viewpoints.frame)

    def _frame(self, t_ns: int) -> int:
        if self.field.frames == 1:
            return 0
        self._start_ns = self._start_ns or t_ns - self.video_lead_ns
        return video_frame(t_ns, self._start_ns, self.field.frame_rate_hz)

    @staticmethod
    def _eyes(record: NDArray[np.void], horizon_ns: int) -> NDArray[np.float64] | None:
        """The predicted eyes; None without a face, or for an impossible one: a single NaN would stay in the averages for ever."""
        if not record["face"]:
            return None
        eyes_px = extrapolated(record["filtered_px"], record["velocity_px_s"], horizon_ns)
        return eyes_px if (np.abs(eyes_px) < FAR_PX).all() else None

    def _pose(self, record: NDArray[np.void]) -> CameraPose | None:
        self._size_px = int(record["width_px"]), int(record["height_px"])
        return CameraPose.of(self.config, self._size_px, self._eyes_mm or EYES_MM)

    def _follow_distance(self, apart_px: float, plain_px: float, dt_s: float, generation: int) -> None:
        """apart_px: as tracked, 0 where not known. plain_px: between the eyes in the picture. What no face has is ignored: an
        average would never forget it."""
        if not LEAST_EYES_PX <= apart_px <= FAR_PX:
            apart_px = max(plain_px, LEAST_EYES_PX)
        if not self._seen:
            self._apart_px = apart_px
        if not self._seen or generation != self._generation:
            self._near_px, self._generation = apart_px, generation
        still = abs(apart_px - self._apart_px) < STILL * self._apart_px
        self._apart_px += (apart_px - self._apart_px) * _share(dt_s, STILL_S if still else DISTANCE_S)
        self._near_px += (apart_px - self._near_px) * _share(dt_s, POSE_S)

    def _follow_presence(
        self, record: NDArray[np.void], t_sensor_ns: int, solver: ViewSolver, eyes_px: NDArray[np.float64] | None
    ) -> None:
        """Runs once per frame: measures neutral position and distance when somebody has come to rest."""
        if t_sensor_ns == self._tracked_ns:
            return
        self._tracked_ns = t_sensor_ns
        x_px, y_px = (0.0, 0.0) if eyes_px is None else eyes_px.mean(axis=0).tolist()
        here = None if eyes_px is None else Rest(x_px, y_px, self._near_px)
        beyond = eyes_px is not None and solver.beyond(eyes_px)
        rest = self.presence.update(t_sensor_ns, here, int(record["generation"]), beyond)
        if rest is not None and self._auto and not self.neutral_is_fixed:
            self._target_px = np.array((rest.x_px, rest.y_px))
            self._choose(rest.apart_px)
            if self.presence.returned and self._centre_px is not None:  # the view is eased to where it was
                self._easing.shift(self._target_px - self._centre_px)
                self._centre_px = self._target_px
                solver.centre_px = (rest.x_px, rest.y_px)

    def _follow_neutral(self, solver: ViewSolver, eyes_px: NDArray[np.float64] | None, dt_s: float) -> None:
        """Moves the neutral position to the measured one, and alpha with the distance; until a rest the grid follows the eyes."""
        assert self.parallax is not None
        if not self._auto or self._centre_px is None:
            return
        if eyes_px is not None and abs(self._apart_px / self.parallax.eyes_px - 1) > MOVED:
            self._choose(self._apart_px)
        solver.alpha_px = self._apart_px / self.parallax.views_between_eyes
        if self.neutral_is_fixed:
            pass
        elif self.presence.state in (ViewerState.ARRIVING, ViewerState.EXCHANGED):
            if eyes_px is not None:
                self._centre_px = solver.dragged(self._centre_px, eyes_px)
        elif self._target_px is not None:
            self._centre_px = self._centre_px + (self._target_px - self._centre_px) * _share(dt_s, NEUTRAL_S)
        solver.centre_px = (float(self._centre_px[0]), float(self._centre_px[1]))

    def _choose(self, apart_px: float) -> None:
        """Chooses the views between the eyes for a viewer at the distance that apart_px implies."""
        width_px, eyes_mm = int(self._size_px[0]), self._eyes_mm or None
        self.parallax = parallax(self.config, self.field, width_px, apart_px, eyes_mm, self._shown_mm)

    def _make_solver(self, eyes_px: NDArray[np.float64] | None) -> ViewSolver:
        """A fixed alpha centres the grid in the camera picture, as in the paper; alpha from geometry centres it on the viewer,
        who is never in the middle of a webcam above the screen."""
        self._choose(self._apart_px)
        assert self.parallax is not None
        if self._auto and self._centre_px is None and eyes_px is not None:
            self._centre_px = eyes_px.mean(axis=0)
        centre_px = (self._size_px[0] / 2, self._size_px[1] / 2) if self._centre_px is None else self._centre_px
        grid = self.field.rows, self.field.cols
        self._solver = ViewSolver(*grid, self.config.render, self.parallax.alpha_px, centre_px, self.method)
        return self._solver


def _share(dt_s: float, time_s: float) -> float:
    """Share of the new value in a low-pass over dt_s: backward Euler, stable for any step."""
    ratio = dt_s / time_s
    return ratio / (1 + ratio)


def video_frame(t_ns: int, start_ns: int, rate_hz: float) -> int:
    """The number of a video's frame at t_ns."""
    return int((t_ns - start_ns) * rate_hz / 1e9)
