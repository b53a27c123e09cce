"""Runs a script through the product and through the paper's loop, in front of a simulated screen:
vblanks at an even rate, which the product's own clock must track.
"""

import math
import time
from collections import deque
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.paper_loop import MEAN_OF
from lfpipe.bench.simulator.camera import (
    IMAGE,
    T0_NS,
    Camera,
    Observer,
    SyntheticNetworks,
    SyntheticPeople,
)
from lfpipe.bench.simulator.scene import SCENES, SimulatedScene, scene_of
from lfpipe.bench.simulator.scripts import Script, Window
from lfpipe.config import Config, Render, Track
from lfpipe.eyes import EYES, EyesRecord
from lfpipe.render.display.refresh import ScreenRefresh
from lfpipe.render.presenter import DisplayTime, EyesSource, choose
from lfpipe.render.synthesis.compositor import Key
from lfpipe.render.synthesis.viewpoint import limited, pair_clamped
from lfpipe.render.viewer.geometry import parallax
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.track.eye_tracker import EyeTracker
from lfpipe.transport.ring import MS_NS, Stamp

EYE_DISTANCES_PX = np.arange(5.0, 301.0)  # at which the right alpha is tabled
Float = NDArray[np.float64]


COST_SPREAD = 0.2  # standard deviation of the logarithm of a picture's cost
WAKE_MS = 0.1  # lateness of wake-ups on a quiet machine
SLOW_MS = 5.0  # lateness of slow wake-ups on a busy machine


@attrs.frozen(kw_only=True)
class Screen:
    """A screen and its compositor."""

    rate_hz: float = 60.0
    device_latency_ms: float = 80.0
    """Delay of camera and display together."""
    slow: float = 0.0
    """Share of late wake-ups."""
    deadline_ms: float = 3.0
    """A picture appears at a vblank if it is submitted this long before it."""
    cost_ms: float = 1.5
    """CPU time of a picture: warp2 at 512x512."""

    @property
    def period_ns(self) -> float:
        return 1e9 / self.rate_hz

    def vblank_ns(self, vblank: int) -> int:
        """The time of a vblank, counted from the start."""
        return round(T0_NS + vblank * self.period_ns)


class PacedScreen:
    """Runs `ScreenRefresh` against a screen: `begin` returns the start time of a picture, `submit`
    the vblank at which it appears.
    """

    def __init__(self, screen: Screen) -> None:
        self._screen = screen
        self._random = np.random.default_rng(5)
        self.refresh = ScreenRefresh(screen.rate_hz, T0_NS)
        self.refresh.clock.vblank(T0_NS)
        self._now_ns = T0_NS
        self.late = 0
        self.missed = 0

    def begin(self) -> tuple[int, int]:
        """(start time of the next picture, time of the vblank that it is due at), ns."""
        refresh = self.refresh
        random = self._random
        due_ns = refresh.due_ns()
        begin_ns = max(self._now_ns, due_ns - refresh.lead_ns())
        late_ms = random.exponential(WAKE_MS)
        late_ms += (random.random() < self._screen.slow) * random.exponential(SLOW_MS)
        self._cost_ms = self._screen.cost_ms * random.lognormal(0, COST_SPREAD)
        return round(begin_ns + late_ms * MS_NS), due_ns

    def submit(self, begun_ns: int, due_ns: int, composed: bool) -> int:
        """Submits the picture; returns the vblank that shows it, counted from the start."""
        refresh = self.refresh
        screen = self._screen
        cost_ns = round(self._cost_ms * MS_NS) * composed
        handed_ns = max(begun_ns + cost_ns, refresh.earliest_ns(due_ns))
        vblank = math.ceil((handed_ns + screen.deadline_ms * MS_NS - T0_NS) / screen.period_ns)
        if composed:
            refresh.add_cost(cost_ns)
            shown_ns = (
                screen.vblank_ns(vblank) // MS_NS * MS_NS + MS_NS // 2
            )  # reported in whole ms
            self.late += refresh.judge(due_ns, handed_ns, shown_ns)
            refresh.clock.vblank(shown_ns)
        self._now_ns = handed_ns
        self.missed += refresh.advance(handed_ns)
        return vblank


@attrs.frozen(kw_only=True)
class Setup:
    """The scene, the camera, the screen and the settings of a simulation."""

    scene: SimulatedScene = attrs.field(factory=lambda: scene_of(SCENES[0]))
    camera: Camera = attrs.Factory(Camera)
    screen: Screen = attrs.Factory(Screen)
    track: Track | None = attrs.Factory(Track)
    """None: the paper's plain loop."""
    method: str = "auto"

    @property
    def config(self) -> Config:
        """The configuration of a session with this screen."""
        render = Render(
            device_latency_ms=self.screen.device_latency_ms,
            method=self.method,  # type: ignore[arg-type]
            alpha_px=self.scene.alpha_px or "auto",
        )
        return Config(track=self.track or Track(), render=render)

    def watch(self, script: Script) -> "Run":
        """The pictures on the screen for a script."""
        if self.track is None:
            return plain_loop(self, script)
        return watch(self, SyntheticPeople(script, self.camera), script.count_ms / 1e3)


@attrs.frozen(eq=False, kw_only=True)
class Run:
    """The pictures on the screen: an entry per refresh, at the middle of its display time."""

    ms: Float
    """(n,): display time since the start."""
    views: Float
    """(n, 2, 2): (row, col) of the left eye and of the right one."""
    keys: list[Key]
    targets_ns: list[int]
    """The vblanks that the pictures were rendered for."""
    cpu_ms: Float
    """Thread CPU time of each choice of eyes, display time and viewpoint."""
    late: float = 0.0
    """Share of pictures that missed their vblank."""

    def key_at(self, ms: float) -> Key:
        """The key of the picture on the screen at ms."""
        return self.keys[max(int(np.searchsorted(self.ms, ms, side="right")) - 1, 0)]


class Shown(NamedTuple):
    """A picture that was submitted for a vblank, due at a time."""

    vblank: int
    due_ns: int
    views: Float
    key: Key


def watch(setup: Setup, observer: Observer, seconds: float) -> Run:
    """The product's pictures for an observer."""
    screen = setup.screen
    config = setup.config
    device_latency_ns = round(screen.device_latency_ms * MS_NS)
    tracker = EyeTracker(
        config.track, device_latency_s=screen.device_latency_ms / 1e3, engine=observer.engine
    )
    viewer = Viewer(setup.scene.field, config)
    source = EyesSource()
    clock = PacedScreen(screen)
    record = np.zeros((), EYES)
    upcoming = deque(setup.camera.frames(seconds))
    end_ns = T0_NS + round(seconds * 1e3) * MS_NS - device_latency_ns
    shown: list[Shown] = []
    choices = []
    while True:
        begun_ns, due_ns = clock.begin()
        if due_ns > end_ns:
            break
        while upcoming and upcoming[0].tracked_ns <= begun_ns:
            frame = upcoming.popleft()
            face, picture = observer.look(frame)
            tracker.update(face, frame.stamp_ns)
            tracker.write(record, picture)
            stamps = frame.stamp_ns, frame.stamp_ns, frame.tracked_ns
            source.update(EyesRecord.of(record), Stamp(frame.seq, frame.seq, 0, *stamps, 0))
        started_ns = time.thread_time_ns()
        display_time = DisplayTime(
            due_ns, clock.refresh.period_ns, device_latency_ns, on_vblanks=True
        )
        viewpoints, key = choose(viewer, source.at(begun_ns), display_time)
        choices.append((time.thread_time_ns() - started_ns) / 1e6)
        composed = not shown or key != shown[-1].key
        vblank = clock.submit(begun_ns, due_ns, composed)
        views = np.array((viewpoints.left, viewpoints.right))
        shown.append(Shown(vblank, due_ns, views, key))
    late = (clock.late + clock.missed) / len(shown)
    return _on_screen(shown, screen, np.array(choices), late)


def plain_loop(setup: Setup, script: Script) -> Run:
    """The paper's loop: the mean of 5 frames, a picture for each frame, the nearest views."""
    scene = setup.scene
    screen = setup.screen
    networks = SyntheticNetworks(script, setup.camera)
    recent: deque[Float] = deque(maxlen=MEAN_OF)
    shown: list[Shown] = []
    grid = scene.rows, scene.cols
    rest = script.windows[0].rest
    alpha_px = Truth(setup, script).alpha_px(rest.eye_distance_px)
    for frame in setup.camera.frames(script.count_ms / 1e3):
        if faces := [one.face for one in networks.seen(frame)]:
            recent.append(max(faces, key=lambda face: face.eye_distance_px).eyes_px)
        if not recent:
            continue
        views = viewpoints(np.mean(recent, axis=0), alpha_px, (rest.x_px, rest.y_px), grid)
        views = np.clip(np.rint(views), 0, np.array(grid) - 1)
        vblank = int((frame.tracked_ns - T0_NS) / screen.period_ns) + 1
        left, right = views.tolist()
        key = (0, (left[0], left[1]), (right[0], right[1]))
        shown.append(Shown(vblank, screen.vblank_ns(vblank), views, key))
    return _on_screen(shown, screen, np.zeros(1))


def _on_screen(shown: list[Shown], screen: Screen, cpu_ms: Float, late: float = 0.0) -> Run:
    """The picture on the screen at every vblank: the newest one submitted for it or before."""
    at = np.array([one.vblank for one in shown])
    vblanks = np.arange(at[0], at[-1] + 1)
    newest = np.searchsorted(at, vblanks, side="right") - 1
    return Run(
        ms=(vblanks + 0.5) * screen.period_ns / MS_NS + screen.device_latency_ms,
        views=np.array([shown[k].views for k in newest]),
        keys=[shown[k].key for k in newest],
        targets_ns=[shown[k].due_ns for k in newest],
        cpu_ms=cpu_ms,
        late=late,
    )


def viewpoints(
    eyes_px: Float, alpha_px: Float | float, centre_px: tuple[float, float], grid: tuple[int, int]
) -> Float:
    """The viewpoint (row, col) of each eye, (..., 2, 2), with one row for both, in an unbounded
    grid.

    eyes_px: (..., 2, 2). alpha_px: px of the camera picture per view, (..., 1) or one. centre_px:
    the eyes whose viewpoint is the middle of the grid, rows x cols.
    """
    middle_y = eyes_px[..., 1].mean(axis=-1, keepdims=True)
    rows = (grid[0] - 1) / 2 + (middle_y - centre_px[1]) / alpha_px
    cols = (grid[1] - 1) / 2 + (centre_px[0] - eyes_px[..., 0]) / alpha_px
    return np.stack([np.broadcast_to(rows, cols.shape), cols], axis=-1)


class Truth:
    """The right viewpoints of a script for a scene: those of the true eyes, by the formula of
    `lfpipe.render.synthesis.viewpoint`, with the alpha for the true distance.
    """

    def __init__(self, setup: Setup, script: Script) -> None:
        self._scene = setup.scene
        self._script = script
        self._render = setup.config.render
        self._alphas_px = [
            parallax(setup.config, self._scene.field, IMAGE.shape[1], eye_distance).alpha_px
            for eye_distance in EYE_DISTANCES_PX.tolist()
        ]

    def alpha_px(self, eye_distance_px: Float | float) -> Float:
        """px of the camera picture per view, for this eye distance."""
        return np.asarray(np.interp(eye_distance_px, EYE_DISTANCES_PX, self._alphas_px))

    def views(self, ms: Float, window: Window) -> Float:
        """The right viewpoints (n, 2, 2) at these ms of a window."""
        rows = self._scene.rows
        cols = self._scene.cols
        eyes = self._script.people[window.person].eyes_px(np.rint(ms).astype(np.int64))
        alpha_px = self.alpha_px(np.hypot(*(eyes[:, 0] - eyes[:, 1]).T))[:, None]
        centre_px = window.rest.x_px, window.rest.y_px
        if self._render.alpha_px != "auto":  # the grid is fixed relative to the camera
            centre_px = IMAGE.shape[1] / 2, IMAGE.shape[0] / 2
        views = viewpoints(eyes, alpha_px, centre_px, (rows, cols))
        reach = self._render.extrapolate_views
        for left, right in views:
            left[0] = right[0] = limited(left[0], 0.0, rows - 1.0, reach)
            left[1], right[1] = pair_clamped(left[1], right[1], cols, reach)
        return views

    def at(self, ms: Float) -> Float:
        """The right viewpoints (n, 2, 2) at these ms, each within a window."""
        windows = self._script.windows
        starts = [window.from_s * 1e3 for window in windows]
        of = np.searchsorted(starts, ms, side="right") - 1
        return np.array([self.views(ms[k : k + 1], windows[of[k]])[0] for k in range(len(ms))])

    def motion(self, ms: Float) -> Float:
        """Largest true motion of any person from each refresh to the next, (n - 1, 2): rows and
        cols, in views.
        """
        whole = np.rint(ms).astype(np.int64)
        motions = []
        for someone in self._script.people:
            eyes = someone.eyes_px(whole)
            steps = np.abs(np.diff(eyes, axis=0)).max(axis=1)[:, ::-1]
            alpha_px = self.alpha_px(np.hypot(*(eyes[1:, 0] - eyes[1:, 1]).T))
            motions.append(steps / alpha_px[:, None])
        return np.asarray(np.max(motions, axis=0))
