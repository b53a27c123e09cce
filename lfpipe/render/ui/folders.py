"""The page that opens a scene from a disk: folders, and files that may be scenes (key l)."""

import re
from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import attrs

from lfpipe.errors import UserError
from lfpipe.files.safe_files import reason
from lfpipe.host.files import exists
from lfpipe.render.display.display import Event, Item, Menu, Overlay
from lfpipe.render.ui.files import Files
from lfpipe.render.ui.notices import short
from lfpipe.render.ui.pages import Page
from lfpipe.render.ui.scenes import UNSEEN, Seen, middle_view
from lfpipe.scene.demo import MARKER
from lfpipe.scene.files import HOLDS_ALL, PICTURES, entries, natural
from lfpipe.scene.recent_scenes import recent_scenes
from lfpipe.transport.context import Context

TITLE_CHARS = 32  # of a path: beside them, a small window has the page's buttons
MAX_PICTURES = 100  # that are looked for
WHOLE = (*HOLDS_ALL, ".mpo", ".jps", ".gif")  # files that are no view of another scene

MAX_LISTED = 1000  # of the names in a folder
VIEWS = 4  # pictures whose names differ in numbers only, from here on: parts of one scene
READING = Overlay(lines=("Reading the folder ...",))


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
        own = (scene.parent for scene in recent_scenes() if not exists(scene / MARKER))
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
    kinds = Counter(_kind(name) for name in files)
    scenes = [name for name in files if name.lower().endswith(WHOLE) or kinds[_kind(name)] < VIEWS]
    return Content(folder, sorted(folders, key=natural), scenes, len(files) - len(scenes))


def _kind(name: str) -> str:
    return re.sub(r"\d+", "", name)


def folder_menu(content: Content, pictures: Mapping[str, Seen]) -> Menu:
    """The content of a folder, as much as there is a place for. pictures: by path."""
    folder = content.folder
    own, up = "Open this folder", folder.parent
    if content.views:
        own = f"Open these {content.views} pictures as one scene"
    fixed = (
        Item(own, Event("load", str(folder)), icon="choose", row=True, main=True),
        Item("Up", Event("enter-folder", str(up)), icon="up", more=_title(up), row=True),
    )
    tiles = [
        Item(name, Event(event, path), icon=kind, picture=seen[0], more=seen[1])
        for event, kind, names in (
            ("enter-folder", "open", content.folders),
            ("load", "file", content.scenes),
        )
        for name in names
        for path in [str(folder / name)]
        for seen in [pictures.get(path, UNSEEN)]
    ]
    more = len(tiles) - MAX_LISTED
    note = (Item(f"{more} more: drop them here", row=True),) if more > 0 else ()
    # with views, it is a scene itself
    at = 0 if content.views or not content.folders else len(fixed)
    return Menu(_title(folder), (*fixed, *note, *tiles[:MAX_LISTED]), at + len(note) * bool(at))


def _title(folder: Path) -> str:
    """The end of a path, in whole names."""
    text = short(folder)
    while len(text) > TITLE_CHARS and text.count("/") > 1:
        text = f"…/{text.removeprefix('…/').partition('/')[2]}"
    return text


class FolderPage(Page):
    """The content of a folder; another one is entered, a file or the folder itself loaded. Scenes
    that were opened before have a picture.
    """

    def __init__(self, context: Context, files: Files) -> None:
        super().__init__()
        self._context = context
        self._files = files
        self._content: Content | None = None
        self._pictures: dict[str, Seen] = {}

    def open(self) -> None:
        """Reads the folder again: files may be new."""
        self._enter(self._content.folder if self._content else None)

    def _enter(self, folder: Path | None) -> None:
        self._files.do(partial(list_folder, folder), self._show)

    def _show(self, content: Content) -> None:
        self._content = content
        self._pictures = {}
        for name in (*content.folders, *content.scenes)[:MAX_PICTURES]:
            path = str(content.folder / name)
            read = partial(middle_view, path, self._context.config.scene)
            self._files.do(read, partial(self._pictures.__setitem__, path))

    def take(self, event: Event) -> bool:
        """Enters a folder."""
        if event.name == "enter-folder":
            self._enter(Path(event.text))
        return event.name == "enter-folder"

    def overlay(self, t_ns: int) -> Overlay:
        if self._content is None:
            return READING
        return Overlay(menu=folder_menu(self._content, self._pictures))
