"""Pages over the picture, at most one at a time: help, metrics, who looks, the question about the
viewer's glasses (key e, and at the first start), and their test (key g), and the measurement of the
camera's focal length by the distance of the viewer's eyes (key k). The page of scenes is in
`lfpipe.render.ui.scenes`.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Render
from lfpipe.config.check import keep_focal
from lfpipe.config.session_options import CameraViewer
from lfpipe.eyes import EYES, EyesRecord
from lfpipe.render.display import ACCENT, BACK, OFF, RED
from lfpipe.render.display.display import VIEWERS, Event, Item, Menu, Overlay
from lfpipe.render.presenter import Drawing, Presenter, draw_scene
from lfpipe.render.synthesis.anaglyph import MATRICES, Pair, arrange_stereo_pair, encode
from lfpipe.render.synthesis.compositor import Key, recipe_for
from lfpipe.render.ui.settings import Files, Settings, metrics
from lfpipe.render.viewer.geometry import SEAT_MM as SEAT_MM
from lfpipe.render.viewer.viewer import Viewer
from lfpipe.transport.context import Context
from lfpipe.transport.ring import SECOND_NS, Reader

Colour = tuple[int, int, int]
# label, more about it, colours of the left and right lens (RGB), value of render.anaglyph
KINDS: tuple[tuple[str, str, tuple[Colour, Colour] | None, str], ...] = (
    ("Red / cyan", "the usual ones", ((220, 30, 30), (0, 190, 200)), "dubois"),
    ("Green / magenta", "", ((20, 170, 40), (210, 40, 200)), "dubois-green-magenta"),
    ("Amber / blue", "", ((240, 170, 0), (30, 40, 190)), "dubois-amber-blue"),
    ("3D television", "side by side", ((60, 60, 60), (60, 60, 60)), "side-by-side"),
    ("No glasses", "a flat picture that moves", None, "mono"),
)
ICON_PX = 480, 240  # width, height: larger than on any screen, so that it is only scaled down
# of the test: both values leave headroom for ghost compensation
GREY, DARK, LIGHT = 128, 60, 235
LETTER_AT = 0.38  # of the height: the middle of the letters
GHOST = "ghost"  # the slider of the test
LOOKS = {"camera": "follows your eyes", "mouse": "move it to look", "demo": "a demonstration"}
FONT = cv2.FONT_HERSHEY_DUPLEX


def _icon(lenses: tuple[Colour, Colour] | None) -> NDArray[np.uint8]:
    """Glasses, or a crossed circle for none: RGBA."""
    picture = np.zeros((ICON_PX[1], ICON_PX[0], 4), np.uint8)
    frame = (200, 200, 200, 255)
    line = 14
    middle, y = ICON_PX[0] // 2, ICON_PX[1] // 2
    if lenses is None:
        cv2.circle(picture, (middle, y), 100, frame, line, cv2.LINE_AA)
        cv2.line(picture, (middle - 70, y + 70), (middle + 70, y - 70), frame, line, cv2.LINE_AA)
    for x, colour in zip((middle - 115, middle + 115), lenses or (), strict=False):
        cv2.ellipse(picture, (x, y), (95, 70), 0, 0, 360, (*colour, 255), -1, cv2.LINE_AA)
        cv2.ellipse(picture, (x, y), (95, 70), 0, 0, 360, frame, line, cv2.LINE_AA)
    return picture


@lru_cache(1)
def glasses_menu(anaglyph: str) -> Menu:
    """The question. anaglyph: the current setting."""
    items = tuple(
        Item(label, Event("wear", value), picture=_icon(lenses), more=more, row=True)
        for label, more, lenses, value in KINDS
    )
    at = next((k for k, (*_, value) in enumerate(KINDS) if value == anaglyph), 0)
    return Menu("Which glasses do you have?", items, at)


def _eye_picture(left: bool, size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """The test picture for one eye, uint8 BGR: its letter in its half, and a frame for both.
    size_px: (width, height).
    """
    width, height = size_px
    picture = np.full((height, width, 3), GREY, np.uint8)
    line = max(2, min(size_px) // 100)
    cv2.rectangle(picture, (line, line), (width - 1 - line, height - 1 - line), (LIGHT,) * 3, line)
    patch = (
        slice(width // 16, width // 2 - width // 32)
        if left
        else slice(width // 2 + width // 32, width - width // 16)
    )
    picture[height // 8 : height - height // 8, patch] = DARK
    letter, scale = "L" if left else "R", min(width / 2, height) / 40
    (wide, high), _ = cv2.getTextSize(letter, FONT, scale, line)
    # above the middle: the lines of the test lie below
    at = (patch.start + patch.stop - wide) // 2, round(LETTER_AT * height) + high // 2
    cv2.putText(picture, letter, at, FONT, scale, (LIGHT,) * 3, 2 * line, cv2.LINE_AA)
    return picture


@lru_cache(1)
def glasses_test(render: Render, size_px: tuple[int, int]) -> tuple[NDArray[np.uint8], Pair | None]:
    """A picture with an L for the left eye and an R for the right one, composed like every other
    picture.

    Returns uint8 (height, width, 3) BGR, and its two views where the mode shows two.
    """
    pair = _eye_picture(True, size_px), _eye_picture(False, size_px)
    if render.swap_eyes:
        pair = pair[::-1]
    if render.anaglyph in MATRICES:
        return encode(*pair, recipe_for(render)), None
    if render.anaglyph == "mono":
        return np.maximum(*pair), None
    return arrange_stereo_pair(pair, render.anaglyph, size_px), pair


def instructions(render: Render) -> Overlay:
    """The running test."""
    swap = Item("Swap the eyes", Event("swap"), "x")
    ghosts = Item(
        f"Ghosts {render.ghost_compensation:.0f} %",
        Event(GHOST),
        slider=render.ghost_compensation / 100,
    )
    others = Item("Other glasses", Event("which"), "e"), Item("Done", Event("glasses"), main=True)
    if render.anaglyph == "mono":
        return Overlay(lines=("No glasses: both eyes see the same.",), items=others)
    if render.anaglyph not in MATRICES:
        return Overlay(lines=("Close your left eye: only R?",), items=(swap, *others))
    lines = "Close your left eye: only R?", "Faint L: raise the slider."
    return Overlay(lines=lines, items=(swap, ghosts, *others))


GHOST_STEPS = {"more": 5.0, "less": -5.0}  # by event, %: the smallest visible change
CHECKED = ("swap_eyes", "ghost_compensation")  # what a test of glasses may change


class Page:
    """A page that can be opened and closed many times. stays: whether it remains when something
    else in the bar is chosen.
    """

    stays = False

    def __init__(self, overlay: Callable[[int], Overlay], stays: bool = False) -> None:
        """overlay: at a time."""
        self.overlay = overlay
        self.stays = stays

    def open(self) -> None:
        """Called when the page opens."""

    def close(self) -> None:
        """Called when the page closes."""

    def handle(self, event: Event) -> bool:
        """Handles an event of its own; returns whether it was one."""
        return False


def metrics_page(context: Context, viewer: Viewer, presenter: Presenter) -> Page:
    """Rate, latency and viewpoint."""

    @lru_cache(1)
    def overlay(tick: int) -> Overlay:
        presenter.redraw()  # what is measured does not rest
        return Overlay(lines=metrics(context, viewer))

    return Page(lambda t_ns: overlay(t_ns // (SECOND_NS // 2)), stays=True)


@lru_cache(1)
def viewer_menu(kind: str) -> Menu:
    """The choice of who looks. kind: as `viewer_kind`."""
    items = tuple(
        Item(label, Event("look", word), icon=word, more=LOOKS[word], row=True)
        for word, label in VIEWERS.items()
    )
    return Menu("Viewer", items, list(VIEWERS).index(kind) if kind else 0)


@attrs.define(eq=False)
class GlassesTest(Page):
    """A letter for each eye in place of the scene; keeps the settings that were changed."""

    _context: Context
    _presenter: Presenter
    _settings: Settings
    _before: Render = attrs.field(factory=Render)

    def open(self) -> None:
        self._before = self._settings.render
        # in place of the scene, as large as the scene's pictures
        self._presenter.draw_by(
            lambda viewer, _: Drawing(
                *glasses_test(viewer.config.render, viewer.compositor.size_px)
            )
        )

    def close(self) -> None:
        self._presenter.draw_by(draw_scene)
        now = attrs.asdict(self._settings.render)
        changed = {name: now[name] for name in CHECKED if now[name] != getattr(self._before, name)}
        if changed:
            self._settings.store(changed)

    def handle(self, event: Event) -> bool:
        """The arrows change ghost compensation."""
        if event.name in GHOST_STEPS:
            ghost = self._settings.render.ghost_compensation + GHOST_STEPS[event.name]
            self._settings.set(ghost_compensation=min(max(ghost, 0.0), 100.0))
        return event.name in GHOST_STEPS

    def overlay(self, t_ns: int) -> Overlay:
        return instructions(self._context.config.render)


NEAREST_CM, FARTHEST_CM = 10, 500
SLIDER_CM = 30, 150  # usual seats
STEPS = {"alpha-": -1, "less": -1, "alpha+": 1, "more": 1}  # cm by event
MEASURED_FRAMES = 45  # with a face: one and a half seconds
SPREAD = 0.05  # limit of the interquartile range as a share of the median: the viewer moved
RING = 1.6  # radius over the distance of the eyes: around the face
BELOW = 0.4  # of the preview's height: the lines and buttons lie there
ACCEPT = Item("Accept", Event("enter"), main=True)
AGAIN = Item("Again", Event("previous"))
DONE = Item("Done", Event("close"), main=True)


@attrs.define
class Distance:
    """A distance to step or to slide."""

    cm: float

    def set(self, cm: float) -> None:
        self.cm = min(max(cm, NEAREST_CM), FARTHEST_CM)

    def handle(self, event: Event) -> bool:
        """Follows an event; returns whether it is one of its own."""
        low, high = SLIDER_CM
        slid_cm = low + round(event.value * (high - low))
        self.set(slid_cm if event.name == "distance" else self.cm + STEPS.get(event.name, 0))
        return event.name in (*STEPS, "distance")

    @property
    def items(self) -> tuple[Item, ...]:
        low, high = SLIDER_CM
        at = min(max((self.cm - low) / (high - low), 0.0), 1.0)
        return (
            Item("", Event("alpha-"), "-"),
            Item(f"{self.cm:g} cm", Event("distance"), slider=at),
            Item("", Event("alpha+"), "+"),
        )


@attrs.define(eq=False)
class StillEyes:
    """Eye distances in px while the head is still."""

    _px: deque[float] = attrs.field(factory=lambda: deque(maxlen=MEASURED_FRAMES))
    has_face: bool = False

    def add(self, eye_distance_px: float | None) -> None:
        """Takes the distance in the next frame, None without a face."""
        self.has_face = eye_distance_px is not None
        if eye_distance_px is not None:
            self._px.append(eye_distance_px)
            low, median, high = np.percentile(self._px, (25, 50, 75)).tolist()
            if not high - low <= SPREAD * median > 0:
                self._px.clear()

    @property
    def share(self) -> float:
        """How much of the measurement is done."""
        return len(self._px) / MEASURED_FRAMES

    @property
    def median_px(self) -> float:
        return float(np.median(self._px))


def mirrored(
    picture: NDArray[np.uint8], eyes_px: Sequence[Sequence[float]], still: float
) -> NDArray[np.uint8]:
    """A mirrored picture with the left and the right eye, and a ring around them of which the
    share `still` is full; without eyes, the picture alone.
    """
    drawn = np.ascontiguousarray(picture[:, ::-1])
    if not eyes_px:
        return drawn
    eyes = [(round(drawn.shape[1] - 1 - x), round(y)) for x, y in eyes_px]
    middle = np.mean(eyes, axis=0).round().astype(int).tolist()
    radius_px = round(RING * math.dist(*eyes))
    size = radius_px, radius_px
    for end, colour in ((270, OFF), (360 * still - 90, ACCENT)):
        cv2.ellipse(drawn, middle, size, 0, -90, end, colour[::-1], 4, cv2.LINE_AA)
    for eye, colour in zip(eyes, (RED, ACCENT), strict=True):  # as the lenses of most glasses
        cv2.circle(drawn, eye, max(4, radius_px // 12), colour[::-1], 2, cv2.LINE_AA)
    return drawn


def calibration_page(distance: Distance, ready: bool, has_face: bool, is_stored: bool) -> Overlay:
    """The lines and buttons."""
    state = "Set your distance from the camera, then hold still"
    if not has_face:
        state = "No face: sit in good light"
    elif ready:
        state = "Saved. To check: move, set the new distance" if is_stored else "Ready"
    last = DONE if is_stored else attrs.evolve(ACCEPT, off=not ready)
    return Overlay(lines=(state,), items=(*distance.items, AGAIN, last))


class CalibrationPage(Page):
    """The camera's mirrored picture in place of the scene, and the distance to set. Accept asks to
    store the focal length.
    """

    def __init__(self, context: Context, presenter: Presenter, files: Files) -> None:
        self._context = context
        self._files = files
        self._presenter = presenter
        self.distance = Distance((context.options.calibrate_mm or SEAT_MM) / 10)
        self.is_stored = False
        """Whether what was accepted is stored and applies."""
        self._eyes = StillEyes()
        self._rings = list[Reader]()
        self._record = np.zeros((), EYES)
        width_px, height_px = context.config.camera.frame_px
        self._frame: NDArray[np.uint8] = np.zeros((height_px, width_px, 3), np.uint8)

    def open(self) -> None:
        segment = self._context.spec.session.segment
        self._rings = [Reader(segment("frames")), Reader(segment("eyes"))]
        self._begin()
        self._presenter.draw_by(self._draw)

    def close(self) -> None:
        self._presenter.draw_by(draw_scene)
        while self._rings:
            self._rings.pop().close()

    def _begin(self) -> None:
        self.is_stored, self._eyes = False, StillEyes()

    def handle(self, event: Event) -> bool:
        if event == ACCEPT.event:
            if self._eyes.share == 1.0 and not self.is_stored:
                eyes_mm = self._context.config.screen.eyes_mm
                focal_px = round(self._eyes.median_px * 10 * self.distance.cm / eyes_mm, 1)
                viewer = self._context.options.viewer
                name = viewer.name if isinstance(viewer, CameraViewer) else ""
                self._files.do(
                    partial(keep_focal, name or viewer.source, focal_px, self._frame.shape[1]),
                    lambda _: self._context.request("keep", focal_px=focal_px),
                )
        elif event == AGAIN.event:
            self._begin()
        elif self.distance.handle(event):
            self.is_stored = False
        else:
            return False
        return True

    def overlay(self, t_ns: int) -> Overlay:
        frames, eyes = self._rings
        if frames.read(self._frame) is not None:
            self._presenter.redraw()
        if eyes.read(self._record) is not None:
            record = EyesRecord.of(self._record)
            distance_px = record.eye_distance_px or math.dist(record.raw_px[:2], record.raw_px[2:])
            self._eyes.add(distance_px if record.face else None)
        return calibration_page(
            self.distance, self._eyes.share == 1.0, self._eyes.has_face, self.is_stored
        )

    def _draw(self, _viewer: Viewer, _key: Key) -> Drawing:
        eyes_px = self._record["raw_px"].tolist() if self._eyes.has_face else []
        drawn = mirrored(self._frame, eyes_px, self._eyes.share)
        edges = 0, round(BELOW * drawn.shape[0]), 0, 0
        framed = cv2.copyMakeBorder(drawn, *edges, cv2.BORDER_CONSTANT, value=BACK[::-1])
        return Drawing(np.asarray(framed, np.uint8), None)
