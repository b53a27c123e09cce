"""A script through the product, and through what it is compared with."""

import time
from collections import deque
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.world.camera import IMAGE, T0_NS, Camera, MadeEngine, WorldEngine
from lfpipe.bench.world.scene import SCENES, WorldScene, scene_of
from lfpipe.bench.world.screen import PacedScreen, Screen
from lfpipe.bench.world.scripts import Script, Window
from lfpipe.config import Config, Render, Track
from lfpipe.eyes import EYES, EyesRecord
from lfpipe.render.choice import EyesSource, Moment, choose
from lfpipe.render.compositor import Key
from lfpipe.render.geometry import parallax
from lfpipe.render.viewer import Viewer
from lfpipe.render.viewpoint import limited, pair_clamped
from lfpipe.track.eye_tracker import EyeTracker
from lfpipe.transport.clock import MS_NS
from lfpipe.transport.ring import Stamp

MEAN_OF = 5  # frames, of the plain loop
APARTS_PX = np.arange(5.0, 301.0)  # distances between the eyes at which the right alpha is tabled
Float = NDArray[np.float64]


@attrs.frozen(kw_only=True)
class Setup:
    """What stands before a viewer, and what follows them."""

    scene: WorldScene = attrs.field(factory=lambda: scene_of(SCENES[0]))
    camera: Camera = attrs.Factory(Camera)
    screen: Screen = attrs.Factory(Screen)
    track: Track | None = attrs.Factory(Track)
    """None: the paper's plain loop."""
    method: str = "auto"

    @property
    def config(self) -> Config:
        """The configuration of a session before this screen."""
        render = Render(
            loop_ms=self.screen.loop_ms,
            method=self.method,  # type: ignore[arg-type]
            alpha_px=self.scene.alpha_px or "auto",
        )
        return Config(track=self.track or Track(), render=render)

    def watch(self, script: Script) -> "Run":
        """What is on the screen for a script."""
        if self.track is None:
            return plain_loop(self, script)
        return watch(self, MadeEngine(script, self.camera), script.count_ms / 1e3)


@attrs.frozen(eq=False, kw_only=True)
class Run:
    """What was on the screen: an entry per refresh of the screen, at the middle of its light."""

    ms: Float
    """(n,) of the light, since the beginning."""
    views: Float
    """(n, 2, 2): (row, col) of the left eye and of the right one."""
    keys: list[Key]
    targets_ns: list[int]
    """The blanks that the pictures were made for."""
    cpu_ms: Float
    """Thread CPU of each choice of eyes, moment and viewpoint."""
    late: float = 0.0
    """Share of pictures that missed their blank."""

    def key_at(self, ms: float) -> Key:
        """The key of the picture whose light is seen at ms."""
        return self.keys[max(int(np.searchsorted(self.ms, ms, side="right")) - 1, 0)]


class Shown(NamedTuple):
    """A picture that was handed over for a blank, due at a time."""

    blank: int
    due_ns: int
    views: Float
    key: Key


def watch(setup: Setup, engine: WorldEngine, seconds: float) -> Run:
    """The product's pictures for what an engine sees."""
    screen = setup.screen
    config = setup.config
    loop_ns = round(screen.loop_ms * MS_NS)
    tracker = EyeTracker(config.track, loop_s=screen.loop_ms / 1e3, engine=engine)
    viewer = Viewer(setup.scene.field, config)
    source = EyesSource()
    clock = PacedScreen(screen)
    record = np.zeros((), EYES)
    upcoming = deque(setup.camera.frames(seconds))
    end_ns = T0_NS + round(seconds * 1e3) * MS_NS - loop_ns
    shown: list[Shown] = []
    choices = []
    while True:
        begun_ns, due_ns = clock.begin()
        if due_ns > end_ns:
            break
        while upcoming and upcoming[0].tracked_ns <= begun_ns:
            frame = upcoming.popleft()
            face, picture = engine.look(frame)
            tracker.update(face, frame.stamp_ns)
            tracker.write(record, picture)
            stamps = frame.stamp_ns, frame.stamp_ns, frame.tracked_ns
            source.update(EyesRecord.of(record), Stamp(frame.seq, frame.seq, 0, *stamps, 0))
        started_ns = time.thread_time_ns()
        moment = Moment.of(due_ns, clock.refresh.period_ns, loop_ns, on_blanks=True)
        choice = choose(viewer, source.at(begun_ns), moment)
        choices.append((time.thread_time_ns() - started_ns) / 1e6)
        composed = not shown or choice.key != shown[-1].key
        blank = clock.hand(begun_ns, due_ns, composed)
        views = np.array((choice.viewpoints.left, choice.viewpoints.right))
        shown.append(Shown(blank, due_ns, views, choice.key))
    late = (clock.late + clock.missed) / len(shown)
    return _on_screen(shown, screen, np.array(choices), late)


def plain_loop(setup: Setup, script: Script) -> Run:
    """The paper's loop: the mean of 5 frames, a picture for each frame, the nearest views."""
    scene = setup.scene
    screen = setup.screen
    engine = MadeEngine(script, setup.camera)
    recent: deque[Float] = deque(maxlen=MEAN_OF)
    shown: list[Shown] = []
    middle = np.array(((scene.rows - 1) / 2, (scene.cols - 1) / 2))
    rest = script.windows[0].rest
    alpha_px = Truth(setup, script).alpha_px(np.array([rest.apart_px]))[0]
    for frame in setup.camera.frames(script.count_ms / 1e3):
        recent.extend(face.eyes_px for face in engine.measured(frame)[:1])
        if not recent:
            continue
        eyes = np.mean(recent, axis=0)
        rows = middle[0] + (eyes[:, 1].mean() - rest.y_px) / alpha_px
        cols = middle[1] + (rest.x_px - eyes[:, 0]) / alpha_px
        views = np.stack([np.full(2, rows), cols], axis=1)
        views = np.clip(np.rint(views), 0, (scene.rows - 1, scene.cols - 1))
        blank = int((frame.tracked_ns - T0_NS) / screen.period_ns) + 1
        left, right = views.tolist()
        key = (0, (left[0], left[1]), (right[0], right[1]))
        shown.append(Shown(blank, screen.blank_ns(blank), views, key))
    return _on_screen(shown, screen, np.zeros(1))


def _on_screen(shown: list[Shown], screen: Screen, cpu_ms: Float, late: float = 0.0) -> Run:
    """What stands on the screen at every blank: the newest picture handed over for it or before."""
    at = np.array([one.blank for one in shown])
    blanks = np.arange(at[0], at[-1] + 1)
    newest = np.searchsorted(at, blanks, side="right") - 1
    return Run(
        ms=(blanks + 0.5) * screen.period_ns / MS_NS + screen.loop_ms,
        views=np.array([shown[k].views for k in newest]),
        keys=[shown[k].key for k in newest],
        targets_ns=[shown[k].due_ns for k in newest],
        cpu_ms=cpu_ms,
        late=late,
    )


class Truth:
    """The right viewpoints of a script before a scene: of the true eyes, by the formula of
    `lfpipe.render.viewpoint`, with the alpha for the true distance.
    """

    def __init__(self, setup: Setup, script: Script) -> None:
        self._scene = setup.scene
        self._script = script
        self._render = setup.config.render
        fixed = self._render.alpha_px
        if isinstance(fixed, str):
            views = [
                parallax(setup.config, self._scene.field, IMAGE.shape[1], apart).views_between_eyes
                for apart in APARTS_PX.tolist()
            ]
            self._alphas_px = APARTS_PX / views
        else:
            self._alphas_px = np.full(len(APARTS_PX), float(fixed))

    def alpha_px(self, apart_px: Float) -> Float:
        """px of the camera picture per view, for eyes so far apart, (n,)."""
        return np.interp(apart_px, APARTS_PX, self._alphas_px)

    def views(self, ms: Float, window: Window) -> Float:
        """The right viewpoints (n, 2, 2) at these ms of a window."""
        scene = self._scene
        someone = self._script.people[window.person]
        whole = np.rint(ms).astype(np.int64)
        eyes = someone.eyes_px(whole)
        alpha_px = self.alpha_px(eyes[:, 0, 0] - eyes[:, 1, 0])[:, None]
        centre = window.rest
        if not isinstance(self._render.alpha_px, str):  # the grid is fixed to the camera
            centre = centre._replace(x_px=IMAGE.shape[1] / 2, y_px=IMAGE.shape[0] / 2)
        cols = (scene.cols - 1) / 2 + (centre.x_px - eyes[..., 0]) / alpha_px
        rows = (scene.rows - 1) / 2 + (eyes[..., 1] - centre.y_px) / alpha_px
        reach = self._render.extrapolate_views
        inside = [pair_clamped(left, right, scene.cols, reach) for left, right in cols.tolist()]
        row = [limited(row, 0.0, scene.rows - 1.0, reach) for row in rows[:, 0].tolist()]
        return np.stack([np.repeat(np.array(row)[:, None], 2, axis=1), np.array(inside)], axis=2)

    def at(self, ms: Float) -> Float:
        """The right viewpoints (n, 2, 2) at these ms, each within a window."""
        windows = self._script.windows
        starts = np.array([window.from_s * 1e3 for window in windows])
        of = np.searchsorted(starts, ms, side="right") - 1
        return np.array([self.views(ms[k : k + 1], windows[of[k]])[0] for k in range(len(ms))])

    def motion(self, ms: Float) -> Float:
        """Largest true motion of any person from each refresh to the next, (n - 1, 2): rows and
        cols, in views.
        """
        whole = np.rint(ms).astype(np.int64)
        largest = np.zeros((len(ms) - 1, 2))
        for someone in self._script.people:
            places = someone.path_px[np.clip(whole, 0, len(someone.path_px) - 1)]
            steps = np.abs(np.diff(places[:, 1::-1], axis=0))
            largest = np.maximum(largest, steps / self.alpha_px(places[1:, 2])[:, None])
        return largest
