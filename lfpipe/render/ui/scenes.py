"""The pages that open a scene: from a disk (key l), and from the playlist (key Tab)."""

import contextlib
import re
from collections import Counter
from collections.abc import Mapping
from functools import lru_cache, partial
from pathlib import Path

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Scene
from lfpipe.errors import UserError, plain
from lfpipe.files.codecs import fit_area
from lfpipe.files.safe_files import reason
from lfpipe.host.files import exists
from lfpipe.render.display.display import VIEWERS, Event, Item, Menu, Overlay
from lfpipe.render.ui.pages import Page
from lfpipe.render.ui.settings import (
    QUESTION_NS,
    Files,
    Notices,
    short,
    viewer_kind,
    viewer_name,
)
from lfpipe.scene.pack import DEMO_MARKER, cache_dir, packed, recent_scenes
from lfpipe.scene.source import HOLDS_ALL, PICTURES, entries, natural, read_bytes
from lfpipe.transport.context import Context
from lfpipe.transport.control import Answer, Message
from lfpipe.transport.ring import SECOND_NS, Reader, now_ns

TITLE_CHARS = 32  # of a path: beside them, a small window has the page's buttons
WHOLE = (*HOLDS_ALL, ".mpo", ".jps", ".gif")  # files that are no view of another scene

MAX_LISTED = 1000  # of the names in a folder, and pictures that are looked for
VIEWS = 4  # pictures whose names differ in numbers only, from here on: parts of one scene


@attrs.frozen
class Content:
    """What a folder holds, by name."""

    folder: Path
    folders: list[str]
    scenes: list[str]
    """Files that may be scenes."""
    views: int = 0
    """The number of pictures beside these."""


def list_folder(folder: Path | None) -> Content:
    """The content of a folder; for None, of that of the last scene that is no demo, or of the home
    directory. Raises UserError.
    """
    if folder is None:
        own = (scene.parent for scene in recent_scenes() if not exists(scene / DEMO_MARKER))
        folder = next(own, Path.home())
    try:
        names, folders = entries(folder)
    except OSError as error:
        raise UserError(
            f"{folder}: cannot be read: {reason(error)}", "check the path and its permissions"
        ) from None
    files = sorted(
        (name for name in names if name.lower().endswith((*HOLDS_ALL, *PICTURES))), key=natural
    )
    kind = {name: re.sub(r"\d+", "", name) for name in files}
    count = Counter(kind.values())
    scenes = [name for name in files if name.lower().endswith(WHOLE) or count[kind[name]] < VIEWS]
    return Content(folder, sorted(folders, key=natural), scenes, len(files) - len(scenes))


def folder_menu(content: Content, pictures: Mapping[str, "Preview"]) -> Menu:
    """The content of a folder, as much as there is a place for. pictures: by path."""
    folder = content.folder
    views, up = content.views, folder.parent
    label = f"Open these {views} pictures as one scene" if views else "Open this folder"
    fixed = (
        Item(label, Event("load", str(folder)), icon="choose", row=True, main=True),
        Item("Up", Event("enter-folder", str(up)), icon="up", more=_title(up), row=True),
    )
    tiles = [
        Item(name, Event(event, path), icon=kind, picture=preview[0], more=preview[1])
        for event, kind, names in (
            ("enter-folder", "open", content.folders),
            ("load", "file", content.scenes),
        )
        for name in names
        for path in [str(folder / name)]
        for preview in [pictures.get(path, NO_PREVIEW)]
    ]
    more = len(tiles) - MAX_LISTED
    note = (Item(f"{more} more: drop them here", row=True),) if more > 0 else ()
    # with views, it is a scene itself
    at = 0 if views or not content.folders else len(fixed) + len(note)
    return Menu(_title(folder), (*fixed, *note, *tiles[:MAX_LISTED]), at)


def _title(folder: Path) -> str:
    """The end of a path, in whole names."""
    text = short(folder)
    while len(text) > TITLE_CHARS and text.count("/") > 1:
        text = f"…/{text.removeprefix('…/').partition('/')[2]}"
    return text


@attrs.define(eq=False)
class FolderPage(Page):
    """The content of a folder; another one is entered, a file or the folder itself loaded. Scenes
    that were opened before have a picture.
    """

    _context: Context
    _files: Files
    _content: Content | None = None
    _pictures: dict[str, "Preview"] = attrs.field(factory=dict)

    def open(self) -> None:
        """Reads the folder again: files may be new."""
        self._enter(self._content.folder if self._content else None)

    def _enter(self, folder: Path | None) -> None:
        self._files.do(partial(list_folder, folder), self._show)

    def _show(self, content: Content) -> None:
        self._content = content
        self._pictures = {}
        for name in (*content.folders, *content.scenes)[:MAX_LISTED]:
            path = str(content.folder / name)
            self._files.do(
                partial(middle_view, path, self._context.config.scene),
                partial(self._pictures.__setitem__, path),
            )

    def handle(self, event: Event) -> bool:
        """Enters a folder."""
        if event.name == "enter-folder":
            self._enter(Path(event.text))
        return event.name == "enter-folder"

    def overlay(self, t_ns: int) -> Overlay:
        if self._content is None:
            return Overlay(lines=("Reading the folder ...",))
        return Overlay(menu=folder_menu(self._content, self._pictures))


# Other scenes: requests for one of the playlist or a dropped one, and their choice by pictures
# (key Tab).
#
# The old scene stays on the screen until the packer has the views of the new one. A second request
# replaces the first.

ELAPSED_STEPS = 200
ALONE_NS = 60 * SECOND_NS  # then the visitor is assumed to have left
OTHER = Item("Open one", Event("open"), "l", main=True)
OPEN = Item("Open a folder or file", Event("open"), icon="open", row=True, main=True)
THUMBNAILS = Path(__file__).parent / "thumbnails"  # by tools.make_docs_pictures
PREVIEW_PX = (480, 360)  # of a thumbnail, at most: larger than a cell of most menus
# of the packer -> what it does, for people
WORK = {
    "opening": "",
    "views": "reading pictures",
    "disparity": "measuring depth",
    "method": "choosing a method",
}
LOOK = Event("who")
Preview = tuple[NDArray[np.uint8] | None, str]  # a small picture of a scene, and what it is
NO_PREVIEW: Preview = None, ""
CAMERA_LOOKS = Item("Viewer", LOOK, icon="camera", row=True)
MOUSE_LOOKS = Item("Viewer: mouse", LOOK, icon="mouse", row=True)


class SceneLoader:
    """Requests scenes.

    opening: what is being loaded for any client, and what is done with it; "" for nothing.
    progress: share of the packer's work on the scene on the screen; None without. working: what it
    does.
    """

    def __init__(self, context: Context, notices: Notices) -> None:
        self._context = context
        self._notices = notices
        self._steps = 0
        self.opening = self.working = ""
        self.progress: float | None = None
        self._unusable = context.options.unusable
        self._first_due_ns = 0
        self._shown_at, self._shown_ns = -1, 0  # scene of the playlist, and since when

    def step(self, step: int) -> None:
        """Requests the scene of the playlist that many steps from the one requested last."""
        if len(self._context.options.playlist) < 2:
            self._notices.show("scene", "No other scene yet", QUESTION_NS, (OTHER,))
            return
        self.opening = self.opening or "Opening ..."
        self._steps += step  # since a scene was shown
        self._context.request("load", step=self._steps)

    def load(self, scene: Path) -> None:
        """Requests the scene at a path, instead of one requested before."""
        self.opening = f"Opening {scene.name} ..."
        self._context.request("load", scene=str(scene))

    def handle(self, answer: Answer) -> None:
        """Handles the answer to a request."""
        if answer.values.get("replaced"):
            return
        self.opening, self._steps = "", 0
        if note := answer.values.get("note"):
            self._notices.show("note", note, QUESTION_NS)

    def report(self, news: Message) -> None:
        """Sets the progress of a load requested by any client, or of the scene on the screen."""
        word, *_ = news["step"].split(" ")
        what = WORK.get(word, news["step"])
        step = f"{what}, {100 * (news['share'] or 0):.0f} %" if what else ""
        if news["shown"]:
            self.working, self.progress = step, news["share"] if step else None
            return
        scenes, scene = self._context.options.playlist, news["scene"]
        place = f" (scene {scenes.index(scene) + 1} of {len(scenes)})" if scene in scenes else ""
        text = f"Opening {Path(scene).name}{place}" + f": {step}" * bool(step)
        self.opening = text if word else ""

    @property
    def elapsed(self) -> float:
        """The share of the time of the scene on show, in steps."""
        passed = (now_ns() - self._shown_ns) / (self._context.options.every_s * SECOND_NS)
        return round(min(max(passed, 0.0), 1.0) * ELAPSED_STEPS) / ELAPSED_STEPS

    def serve(self, t_ns: int) -> None:
        """Says which scenes cannot be opened. In a locked window, requests the next scene in time,
        or the first one for the next visitor.
        """
        options = self._context.options
        for path in options.unusable.keys() - self._unusable.keys():
            self._notices.show("unusable", f"Not shown: {options.unusable[path]}", QUESTION_NS)
        self._unusable = options.unusable
        if self.opening or options.playlist_at != self._shown_at:
            self._shown_at, self._shown_ns = options.playlist_at, t_ns
        if options.every_s and len(options.playlist) > 1:
            if t_ns - self._shown_ns > options.every_s * SECOND_NS:
                self._shown_ns = t_ns
                self.step(1)
            return
        is_alone = t_ns - int(self._context.row["t_face_ns"]) > ALONE_NS
        if options.lock_code and options.playlist_at and is_alone and t_ns > self._first_due_ns:
            self._first_due_ns = t_ns + ALONE_NS  # it may need packing again
            self._context.request("load", at=0)


@lru_cache(1)
def caption(scene: Path, name: str) -> tuple[str, str]:
    """The title of a scene and what there is to say about it, by captions.txt beside it: NAME:
    TITLE | TEXT, a line each; without, its name alone.
    """
    with contextlib.suppress(UserError, OSError):
        for line in read_bytes(scene.parent / "captions.txt").decode(errors="replace").splitlines():
            file, _, about = line.partition(":")
            if file.strip() == scene.name:
                title, _, text = about.partition("|")
                return plain(title.strip()), plain(text.strip())
    return name, ""


def middle_view(scene: str, settings: Scene) -> Preview:
    """A small picture of a scene, RGB, from its pack, and what it is; None and nothing if it was
    never opened.
    """
    with contextlib.suppress(UserError, OSError):
        if (field := packed(scene, settings)) is not None:
            grey_or_rgb = np.moveaxis(field.views[0, field.rows // 2, field.cols // 2], 0, -1)
            _, _, *small_px = fit_area((field.width_px, field.height_px), PREVIEW_PX)
            small = cv2.resize(grey_or_rgb, small_px, interpolation=cv2.INTER_AREA)
            rgb = np.broadcast_to(np.atleast_3d(small), (*small.shape[:2], 3))
            count = field.rows * field.cols
            views = "stereo" if count == 2 else f"{field.rows} x {field.cols} views"
            return np.asarray(rgb), views if count > 1 else "one view"
    return NO_PREVIEW


@attrs.define(eq=False)
class ScenePage(Page):
    """The scenes of the playlist as a menu, with who looks."""

    _context: Context
    _files: Files
    _pictures: dict[str, Preview] = attrs.field(factory=dict)
    _camera: Reader | None = None
    _camera_due_ns: int = 0
    _camera_item: Item = CAMERA_LOOKS

    def overlay(self, t_ns: int) -> Overlay:
        """The page with the pictures read so far; selects the scene on show."""
        options = self._context.options
        if options.viewer.tracked and self._camera is not None and t_ns >= self._camera_due_ns:
            # a motion is visible, and the scene keeps its rate
            self._camera_due_ns = t_ns + SECOND_NS // 5
            self._read_camera(self._camera)
        shown = options.playlist[options.playlist_at]
        kind = viewer_kind(options.viewer)
        items = [OPEN, *([MOUSE_LOOKS if kind == "mouse" else self._camera_item] if kind else [])]
        for heading, demos in (("Recent" if options.start else "Scenes", False), ("Demos", True)):
            tiles = [self._tile(one) for one in options.playlist if self._is_demo(one) == demos]
            items += [Item(heading, row=True), *tiles] if tiles else []
        at = next((k for k, item in enumerate(items) if item.event.text == shown), 0)
        return Overlay(menu=Menu("lfpipe" if options.start else "Choose a scene", tuple(items), at))

    def _tile(self, scene: str) -> Item:
        picture, what = self._pictures.get(scene, NO_PREVIEW)
        why = self._context.options.unusable.get(scene, "")
        path = Path(scene)
        return Item(
            path.stem if path.suffix.lower() in (*PICTURES, *HOLDS_ALL) else path.name,
            Event("load", scene),
            icon="file",
            picture=picture,
            warns=bool(why),
            more=why or what,
        )

    def open(self) -> None:
        """Reads the pictures again, as one may have been packed since. Those of our own making are
        in the package.
        """
        options = self._context.options
        for scene in options.playlist:
            stored = THUMBNAILS / f"{Path(scene).name}.jpg"
            if self._is_demo(scene) and exists(stored):
                picture = np.asarray(cv2.imread(str(stored)), np.uint8)[..., ::-1]
                self._pictures[scene] = picture, ""
            else:
                self._files.do(
                    partial(middle_view, scene, self._context.config.scene),
                    partial(self._pictures.__setitem__, scene),
                )
        if options.viewer.tracked and self._camera is None:
            self._camera = Reader(self._context.spec.session.segment("frames"))

    def _is_demo(self, scene: str) -> bool:
        """Whether a scene is of our own making: it is always there."""
        return Path(scene).is_relative_to(cache_dir(self._context.config.scene))

    def _read_camera(self, camera: Reader) -> None:
        """Reads the camera's newest picture, and mirrors it."""
        frame_px = self._context.config.camera.frame_px
        frame = np.empty((*frame_px[::-1], 3), np.uint8)
        if camera.read(frame) is not None:
            small_px = fit_area(frame_px, PREVIEW_PX)[2:]
            small = np.asarray(cv2.resize(frame, small_px, interpolation=cv2.INTER_AREA), np.uint8)
            name = viewer_name(self._context.options.viewer)
            answer = "I see you" if self._context.row["face"] else "no face seen"
            self._camera_item = Item(
                f"Viewer: {name.lower()}",
                LOOK,
                picture=small[:, ::-1, ::-1],
                more=answer if name == VIEWERS["camera"] else "",
                row=True,
            )
