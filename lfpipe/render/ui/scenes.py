"""Other scenes: requests for one of the playlist or a dropped one, and their choice by pictures
(key Tab).

The old scene stays on the screen until the packer has the views of the new one. A second request
replaces the first.
"""

import contextlib
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Scene
from lfpipe.errors import UserError
from lfpipe.files.decoding import fit_area
from lfpipe.host.files import exists
from lfpipe.render.display.display import Event, Item, Menu, Overlay
from lfpipe.render.ui.files import Files
from lfpipe.render.ui.notices import Notices, for_window, viewer_kind
from lfpipe.render.ui.pages import Page
from lfpipe.scene.cache import cache_dir, packed
from lfpipe.scene.recent_scenes import forget_scene
from lfpipe.transport.clock import SECOND_NS
from lfpipe.transport.context import Context
from lfpipe.transport.control import Answer, Message
from lfpipe.transport.ring import Reader

ALONE_NS = 60 * SECOND_NS  # then the visitor is assumed to have left
NO_OTHER = "there is no other scene: press l, or drop a folder of views onto the window"
# of a refusal in the picture; lines of the reason, and of the remedy
REFUSED_NS = NOTES_NS = 6 * SECOND_NS
# between two pictures of the camera: a motion is visible, and the scene keeps its rate
CAMERA_NS = SECOND_NS // 5
THUMBNAILS = Path(__file__).parent / "thumbnails"  # by tools.make_docs_pictures
KEPT_PX = (480, 360)  # of a thumbnail, at most: larger than a cell of most menus
# of the packer -> what it does, for people
WORK = {"views": "reading pictures", "disparity": "measuring depth", "method": "choosing a method"}
LOOK = Event("who")
NO_CAMERA = Item("no camera: the mouse looks around", Event("who", "mouse"))
HINT = "Click, or use the arrows and Enter. Tab goes back.\nDrop a folder of views to open it.{}"


class SceneLoader:
    """Requests scenes.

    progress: share of the packer's work on the scene on the screen; None without. working: what it
    does.
    """

    def __init__(self, context: Context, notices: Notices) -> None:
        self._context = context
        self._notices = notices
        self._steps = 0
        self._opening = ""  # what is being loaded for any client, and what is done with it
        self.progress: float | None = None
        self.working = ""
        self._unusable = context.options.unusable
        self._first_due_ns = 0
        self._shown_at, self._shown_ns = -1, 0  # scene of the playlist, and since when

    def step(self, step: int) -> None:
        """Requests the scene of the playlist that many steps from the one requested last."""
        if len(self._context.options.playlist) < 2:
            self._notices.show("scene", NO_OTHER)
            return
        self._opening = self._opening or "Opening ..."
        self._steps += step  # since a scene was shown
        self._context.request("load", step=self._steps)

    def load(self, scene: Path) -> None:
        """Requests the scene at a path, instead of one requested before."""
        self._opening = f"Opening {scene.name} ..."
        self._context.request("load", scene=str(scene))

    def handle(self, answer: Answer) -> None:
        """Handles the answer to a request."""
        if answer.values.get("replaced"):
            return
        if answer.cmd == "load":
            self._opening, self._steps = "", 0
        if not answer.ok:
            self.refuse(answer.error, answer.remedy)
        elif note := answer.values.get("note"):
            self._notices.show("note", note, NOTES_NS)

    def refuse(self, error: str, remedy: str) -> None:
        """Shows a refusal for a while."""
        self._notices.show("refused", for_window(error, remedy), REFUSED_NS)

    def report(self, news: Message) -> None:
        """Sets the progress of a load requested by any client, or of the scene on the screen."""
        word, *_ = news["step"].split(" ")
        step = f"{WORK.get(word, news['step'])}, {100 * (news['share'] or 0):.0f} %" if word else ""
        if news["shown"]:
            self.working, self.progress = step, news["share"] if word else None
            return
        scenes, scene = self._context.options.playlist, news["scene"]
        place = f" (scene {scenes.index(scene) + 1} of {len(scenes)})" if scene in scenes else ""
        self._opening = f"Opening {Path(scene).name}{place}: {step}" if step else ""

    def status(self) -> str:
        """What is being loaded; "" for nothing."""
        return self._opening

    def serve(self, t_ns: int) -> None:
        """Says which scenes cannot be opened. In a locked window, requests the next scene in time,
        or the first one for the next visitor.
        """
        options = self._context.options
        for path in options.unusable.keys() - self._unusable.keys():
            self._notices.show("unusable", f"{Path(path).name}: {options.unusable[path]}", NOTES_NS)
        self._unusable = options.unusable
        if self._opening or options.playlist_at != self._shown_at:
            self._shown_at, self._shown_ns = options.playlist_at, t_ns
        if options.every_s and len(options.playlist) > 1:
            if t_ns - self._shown_ns > options.every_s * SECOND_NS:
                self._shown_ns = t_ns
                self.step(1)
            return
        alone_ns = t_ns - int(self._context.row["t_face_ns"])
        if (
            options.lock_code
            and options.playlist_at
            and alone_ns > ALONE_NS
            and t_ns > self._first_due_ns
        ):
            self._first_due_ns = t_ns + ALONE_NS  # it may need packing again
            self._context.request("load", at=0)


def middle_view(scene: str, settings: Scene) -> NDArray[np.uint8] | None:
    """A small picture of a scene, RGB, from its pack; None if it was never opened."""
    with contextlib.suppress(UserError, OSError):
        if (field := packed(scene, settings)) is not None:
            planes = field.views[0, field.rows // 2, field.cols // 2]
            grey_or_rgb = np.moveaxis(planes, 0, -1)
            _, _, *small_px = fit_area((field.width_px, field.height_px), KEPT_PX)
            small = cv2.resize(grey_or_rgb, small_px, interpolation=cv2.INTER_AREA)
            return np.asarray(np.broadcast_to(np.atleast_3d(small), (*small.shape[:2], 3)))
    return None


class ScenePage(Page):
    """The scenes of the playlist as a menu, with the camera's picture."""

    def __init__(self, context: Context, files: Files) -> None:
        super().__init__()
        self._context = context
        self._files = files
        self._playlist = context.options.playlist
        self._scenes = list(self._playlist)  # without those taken off the start page
        self._at = 0
        self._pictures: dict[str, NDArray[np.uint8] | None] = {}  # None: never opened
        self._camera: Reader | None = None
        self._camera_due_ns = 0
        self._camera_item = Item("your camera", LOOK)

    def menu(self) -> Menu:
        """The page with the pictures read so far."""
        items = [
            Item(Path(scene).name, Event("load", scene), picture=self._pictures.get(scene))
            for scene in self._scenes
        ]
        kind = viewer_kind(self._context.options.viewer)
        if kind == "mouse":
            items.append(NO_CAMERA)
        elif kind:
            items.append(self._camera_item)
        delete = " Delete removes a scene." if self._context.options.start else ""
        return Menu("Choose a scene", HINT.format(delete), tuple(items), self._at)

    def open(self) -> None:
        """Selects the scene on show, and reads the pictures again, as one may have been packed
        since. Those of our own making are in the package.
        """
        options = self._context.options
        if options.playlist != self._playlist:
            self._playlist = options.playlist
            self._scenes = list(self._playlist)
        now = options.playlist[options.playlist_at]
        self._at = self._scenes.index(now) if now in self._scenes else 0
        stored = {scene: THUMBNAILS / f"{Path(scene).name}.jpg" for scene in self._scenes}
        self._pictures = {
            scene: np.asarray(cv2.imread(str(path)), np.uint8)[..., ::-1]
            for scene, path in stored.items()
            if self._is_own(scene) and exists(path)
        }
        for scene in self._scenes:
            if scene not in self._pictures:
                read = partial(middle_view, scene, self._context.config.scene)
                self._files.do(read, partial(self._pictures.__setitem__, scene))
        if options.viewer.tracked and self._camera is None:
            self._camera = Reader(self._context.spec.session.segment("frames"))

    def _is_own(self, scene: str) -> bool:
        """Whether a scene is of our own making: it is always there."""
        return Path(scene).is_relative_to(cache_dir(self._context.config.scene))

    def take(self, event: Event) -> bool:
        """Delete takes a scene off the start page; the demos stay, and so do all files."""
        scene = event.text
        if event.name != "delete":
            return False
        if self._context.options.start and scene in self._scenes and not self._is_own(scene):
            self._scenes.remove(scene)
            self._files.do(partial(forget_scene, Path(scene)))
        return True

    def overlay(self, t_ns: int) -> Overlay:
        is_tracked = self._context.options.viewer.tracked
        if is_tracked and self._camera is not None and t_ns >= self._camera_due_ns:
            self._camera_due_ns = t_ns + CAMERA_NS
            self._see_camera(self._camera)
        return Overlay(menu=self.menu())

    def _see_camera(self, camera: Reader) -> None:
        """Takes the camera's newest picture, mirrored."""
        options = self._context.options
        frame_px = self._context.config.camera.frame_px
        frame = np.empty((*frame_px[::-1], 3), np.uint8)
        if camera.read(frame) is None:
            return
        small_px = fit_area(frame_px, KEPT_PX)[2:]
        small = np.asarray(cv2.resize(frame, small_px, interpolation=cv2.INTER_AREA), np.uint8)
        caption = "a face: here you are" if self._context.row["face"] else "no face seen"
        if viewer_kind(options.viewer) == "demo":
            caption = "recorded face"
        self._camera_item = Item(caption, LOOK, picture=small[:, ::-1, ::-1])
