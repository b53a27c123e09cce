"""The depth order of a packed scene: which of two opposite orders of its views is shown.

Reversing rows and columns inverts depth (pseudoscopic order) and the sign of disparity. The images
alone rarely determine the order, so a pack holds the views as stored, and the order is state of the
session: `scene.invert_depth`, else the user's earlier choice for this scene, else the order that
the pack's manifest states.

    STATE/depth_order/KEY      "yes", "no", or "asked" once the window has asked
"""

import contextlib
from pathlib import Path

import platformdirs

from lfpipe.files.safe_files import read_bytes, write_file
from lfpipe.scene.lightfield import LightField


def folder() -> Path:
    """The folder of the choices; it need not exist."""
    return Path(platformdirs.user_state_dir("lfpipe")) / "depth_order"


def remembered(field: LightField) -> str:
    """ "yes", "no", "asked", or "" if the user was not asked about this scene."""
    with contextlib.suppress(OSError, UnicodeDecodeError):
        word = read_bytes(folder() / field.manifest.key).decode()
        return word if word in ("yes", "no", "asked") else ""
    return ""


def remember(field: LightField, word: str) -> None:
    """Stores the choice for this scene, by its content.

    Does nothing if the folder is not writable: the session goes on.
    """
    with contextlib.suppress(OSError):
        write_file(folder() / field.manifest.key, word.encode())


def shown_as(field: LightField, setting: str) -> LightField:
    """The field in the order that scene.invert_depth = setting asks for. Copies nothing."""
    word = setting if setting != "auto" else remembered(field)
    turned = word == "yes" if word in ("yes", "no") else field.manifest.orientation.invert_depth
    return field if turned == field.depth_inverted else field.inverted()


def undecided(field: LightField, setting: str) -> bool:
    """Whether the depth order of the field is a guess that the user was not asked about."""
    return (
        setting == "auto"
        and not field.manifest.orientation.depth_order_sure
        and not remembered(field)
    )
