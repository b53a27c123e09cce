"""The page that opens a scene from a disk: folders, and files that may be scenes (key l)."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.files.safe_files import reason
from lfpipe.host.files import exists
from lfpipe.render.display.display import Event, Item, Menu, Overlay
from lfpipe.render.ui.files import Files
from lfpipe.render.ui.pages import Page
from lfpipe.scene.demo import MARKER
from lfpipe.scene.files import HOLDS_ALL, PICTURES, entries, natural
from lfpipe.scene.recent_scenes import recent_scenes

HINT = "Click, or use the arrows and Enter. To show the views in this folder, open it."
TITLE_CHARS = 32  # of the end of a path: beside them, a small window has the page's buttons
MAX_LISTED = 1000  # of the names in a folder
READING = Overlay(lines=("Reading the folder ...",))


def list_folder(folder: Path | None) -> tuple[Path, list[str], list[str]]:
    """A folder, its folders, and its files that may be scenes; for None, the folder of the last
    scene that is no demo, or the home directory. Raises UserError.
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
    files = [name for name in names if name.lower().endswith((*HOLDS_ALL, *PICTURES))]
    return folder, sorted(folders, key=natural), sorted(files, key=natural)


def folder_menu(folder: Path, folders: Sequence[str], files: Sequence[str]) -> Menu:
    """The content of a folder by names, as many as there is a place for."""
    more = max(0, len(folders) + len(files) - MAX_LISTED)
    folders = folders[:MAX_LISTED]
    files = files[: MAX_LISTED - len(folders)]
    fixed = (
        Item("Open this folder", Event("load", str(folder)), icon="choose"),
        Item("Parent folder", Event("enter-folder", str(folder.parent)), icon="up"),
    )
    inner = (Item(name, Event("enter-folder", str(folder / name)), icon="open") for name in folders)
    scenes = (Item(name, Event("load", str(folder / name)), icon="file") for name in files)
    hint = HINT + (f"\n{more} more are not listed: drop them here." if more else "")
    # with files, it may be a scene itself
    at = 0 if files or not folders else len(fixed)
    title = str(folder)
    if len(title) > TITLE_CHARS:
        title = f"…{title[-TITLE_CHARS:]}"
    return Menu(title, hint, (*fixed, *inner, *scenes), at)


class FolderPage(Page):
    """The content of a folder; another one is entered, a file or the folder itself loaded."""

    def __init__(self, files: Files) -> None:
        super().__init__()
        self._files = files
        self._folder: Path | None = None
        self._menu: Menu | None = None

    def open(self) -> None:
        """Reads the folder again: files may be new."""
        self._enter(self._folder)

    def _enter(self, folder: Path | None) -> None:
        self._files.do(partial(list_folder, folder), self._show)

    def _show(self, content: tuple[Path, list[str], list[str]]) -> None:
        self._folder = content[0]
        self._menu = folder_menu(*content)

    def take(self, event: Event) -> bool:
        """Enters a folder."""
        if event.name == "enter-folder":
            self._enter(Path(event.text))
        return event.name == "enter-folder"

    def overlay(self, t_ns: int) -> Overlay:
        return READING if self._menu is None else Overlay(menu=self._menu)
