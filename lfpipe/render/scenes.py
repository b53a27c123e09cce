"""Other scenes: requests for one of the playlist or a dropped one, their choice by pictures (key Tab), and the desktop's dialog.

The old scene stays on the screen until the packer has the views of the new one. A second request replaces the first.
"""

import contextlib
import shutil
import subprocess
import textwrap
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError
from lfpipe.files.decoding import fit_area
from lfpipe.render.notices import Notices
from lfpipe.render.overlay import Item, Menu
from lfpipe.scene.cache import cache_dir
from lfpipe.scene.contact_sheet import stored_view
from lfpipe.scene.open_scene import Packing, packed, preview
from lfpipe.scene.recent_scenes import forget_scene
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.context import Context
from lfpipe.transport.ring import Reader

ALONE_NS = 60 * SECOND_NS  # then the visitor is assumed to have left
NO_OTHER = "there is no other scene: `lfpipe up` accepts several"
REFUSED_NS, LINE_CHARS, MAX_LINES = (
    6 * SECOND_NS,
    60,
    5,
)  # of a refusal in the picture; lines of the reason, and of the remedy
CAMERA_NS = (
    SECOND_NS // 5
)  # between two pictures of the camera: one sees oneself move, and the scene keeps its rate
KEPT_PX = (480, 360)  # of a thumbnail, at most: larger than a cell of most menus
HINT = "Click, or arrows and Enter; {}Tab goes back.\nOr drop a folder of views onto the window."


class SceneLoader:
    """Requests scenes. share: of the packer's work on the scene on the screen that is done; None without."""

    def __init__(self, context: Context, notices: Notices) -> None:
        self._context, self._notices = context, notices
        self._asked, self._asked_ns = "", 0  # the scene requested last that is not loaded yet
        self._loading, self._step = (
            "",
            "",
        )  # the name of the scene being loaded, whoever requested it, and its progress
        self.share: float | None = None
        self._first_due_ns = 0

    def step(self, step: int) -> None:
        """Requests the scene of the playlist that many steps from the one requested last."""
        scenes = self._context.options.playlist
        if len(scenes) < 2:
            self._notices.say("scene", NO_OTHER)
            return
        at = (
            scenes.index(self._asked)
            if self._asked in scenes
            else self._context.options.playlist_at
        )
        self.load(Path(scenes[(at + step) % len(scenes)]))

    def load(self, scene: Path) -> None:
        """Requests the scene at a path, instead of one requested before."""
        self._context.request("load", scene=str(scene))
        self._asked, self._asked_ns = str(scene), now_ns()

    def answered(self, answer: dict[str, Any]) -> None:
        """Handles the answer to a request: the picture shows a refusal for a while."""
        if answer.get("replaced"):
            return
        if not answer["ok"]:
            lines = [f"{self._what()}: refused".removeprefix(": ")]
            for text in (answer["error"], answer.get("remedy", "")):
                lines += textwrap.wrap(text, LINE_CHARS)[:MAX_LINES]
            self._notices.say("refused", "\n".join(lines), REFUSED_NS)
        if not answer["ok"] or "pack" in answer:
            self._asked = ""

    def report(self, news: dict[str, Any]) -> None:
        """Takes the progress of loading, whoever requested the scene. Of the scene on the screen, only a line shows it."""
        self._loading, self._step = ("", "") if news["shown"] else (news["scene"], news["step"])
        self.share = news["share"] if news["shown"] and news["step"] else None

    def _what(self) -> str:
        scenes = self._context.options.playlist
        if self._asked:
            place = (
                f": {scenes.index(self._asked) + 1} of {len(scenes)}"
                if self._asked in scenes
                else ""
            )
            return f"loading {Path(self._asked).name}{place}"
        return f"loading {self._loading}" if self._step else ""

    def words(self, t_ns: int) -> str:
        """What is being loaded, how far it is, and for how long; "" for nothing."""
        waited_s = (t_ns - self._asked_ns) // SECOND_NS if self._asked else 0
        return ", ".join(
            filter(None, [self._what(), self._step, f"{waited_s} s" if waited_s else ""])
        )

    def serve(self, t_ns: int) -> None:
        """In an exhibition, requests the first scene for the next visitor."""
        options, alone_ns = self._context.options, t_ns - int(self._context.row["t_face_ns"])
        if (
            options.kiosk
            and options.playlist_at
            and alone_ns > ALONE_NS
            and t_ns > self._first_due_ns
        ):
            self._first_due_ns = t_ns + ALONE_NS  # it may need packing again
            self._context.request("load", at=0)


def _small(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    _, _, width, height = fit_area((picture.shape[1], picture.shape[0]), KEPT_PX)
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


class ScenePage:
    """The scenes of the playlist as a menu, with the camera's picture."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._scenes: list[str] = list(context.options.playlist)
        self._at = 0
        self._pictures: dict[str, NDArray[np.uint8] | None] = {}
        self._packings: dict[
            str, Packing
        ] = {}  # at most one: it reads a picture of a scene that is not packed
        self._camera: Reader | None = None
        self._camera_due_ns = 0
        self._camera_item = Item("the camera")

    def menu(self) -> Menu:
        """The page with the pictures read so far."""
        items = [
            Item(Path(scene).name, f"load {scene}", picture=self._pictures.get(scene))
            for scene in self._scenes
        ]
        if self._camera is not None:
            items.append(self._camera_item)
        hint = HINT.format("Delete removes a scene; " if self._context.options.start else "")
        return Menu("Choose a scene", hint, tuple(items), self._at)

    def open(self) -> None:
        """Selects the scene on show; reads the pictures again, as one may have been packed since."""
        options = self._context.options
        now = options.playlist[options.playlist_at]
        self._at = self._scenes.index(now) if now in self._scenes else 0
        self._pictures.clear()
        if options.tracking and self._camera is None:
            self._camera = Reader(self._context.spec.session.segment("frames"))

    def close(self) -> None:
        """Ends what reads pictures."""
        for scene in list(self._packings):
            self._packings.pop(scene).close()

    def _is_own(self, scene: str) -> bool:
        """Whether a scene is of our own making: it is always there, and its views take a while to render."""
        return Path(scene).is_relative_to(cache_dir(self._context.config.scene))

    def forget(self, scene: str) -> None:
        """Takes a scene off the start page; the demos stay, and so do all files."""
        if self._context.options.start and scene in self._scenes and not self._is_own(scene):
            self._scenes.remove(scene)
            if scene in self._packings:
                self._packings.pop(scene).close()
            forget_scene(Path(scene))

    def serve(self, t_ns: int) -> None:
        """Reads one more thumbnail and, now and then, the camera's picture."""
        unread = [scene for scene in self._scenes if scene not in self._pictures]
        if unread:
            with self._context.busy_with("reading thumbnails"):
                self._read_picture(min(unread, key=self._is_own))
        if self._camera is not None and t_ns >= self._camera_due_ns:
            self._camera_due_ns = t_ns + CAMERA_NS
            self._see_camera(self._camera)

    def _read_picture(self, scene: str) -> None:
        """Reads the middle view from the scene's pack, or has the packer read it."""
        if scene not in self._packings:
            with contextlib.suppress(UserError):
                if (field := packed(scene, self._context.config.scene)) is not None:
                    self._pictures[scene] = _small(
                        stored_view(field, field.rows // 2, field.cols // 2)
                    )
                    return
            self._packings[scene] = Packing([scene], self._context.config.scene, do="preview")
        self._packings[scene].read()
        if self._packings[scene].done:
            self._pictures[scene] = preview(self._packings.pop(scene))

    def _see_camera(self, camera: Reader) -> None:
        """Takes the camera's newest picture, mirrored."""
        options, (width_px, height_px) = self._context.options, self._context.config.camera.frame_px
        frame = np.empty((height_px, width_px, 3), np.uint8)
        if camera.read(frame) is None:
            return
        caption = "a face: here you are" if self._context.row["face"] else "no face seen"
        if options.source.startswith("demo"):
            caption = "demo face: no camera found" if options.start else "demo face"
        self._camera_item = Item(caption, picture=_small(frame)[:, ::-1, ::-1])


# A portal's answer is a signal to the connection that asked; `gdbus call` and `busctl call` have closed theirs by then.
NO_DIALOG = "drop a folder or a file onto the window (zenity or kdialog would give a dialog)"


def file_dialog(folder: bool) -> subprocess.Popen[str] | None:
    """The desktop's own dialog for a folder or a file, a child process that prints its path; None if there is none."""
    title = "Open a folder of views" if folder else "Open a light field"
    if program := shutil.which("zenity"):
        command = [
            program,
            "--file-selection",
            f"--title={title}",
            *(["--directory"] if folder else []),
        ]
    elif program := shutil.which("kdialog"):
        command = [
            program,
            "--title",
            title,
            "--getexistingdirectory" if folder else "--getopenfilename",
            str(Path.home()),
        ]
    else:
        return None
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
