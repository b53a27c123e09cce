"""The face networks: four files of one mediapipe wheel, from the installed package or from the user's data folder.

mediapipe has no wheel for some machines and Pythons. There the files alone are taken out of a wheel made for another machine,
which the installer at hand (uv or pip) fetches by the package's name. Their contents are the same in all of them.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.files.safe_files import check_regular, reason, replaced

VERSION = "0.10.21"  # the last one that carries these files
PACKAGE = f"mediapipe=={VERSION}"
SHA256 = {
    "modules/face_detection/face_detection_short_range.tflite": (
        "bbff11cebd1eb27a1e004cae0b0e63ec8c551cbf34a4451148b4908b8db3eca8"
    ),
    "modules/face_detection/face_detection_full_range_sparse.tflite": (
        "2c3728e6da56f21e21a320433396fb06d40d9088f2247c05e5635a688d45dfe1"
    ),
    "modules/face_landmark/face_landmark.tflite": "1055cb9d4a9ca8b8c688902a3a5194311138ba256bcc94e336d8373a5f30c814",
    "modules/iris_landmark/iris_landmark.tflite": "d1744d2a09c25f501d39eba4faff47e53ecca8852c5ce19bce8eeac39357521f",
}
MOST_BYTES = 16 << 20  # of one network; the largest has 2.6 MB
REMEDY = "`lfpipe models get`, or without a network `lfpipe models get --from WHEEL` with any wheel of " + PACKAGE
# The options by which an installer takes the wheel of one certain platform, whatever machine this is.
_UV = ("--python-platform", "x86_64-manylinux_2_28", "--python-version", "3.12")
_PIP = ("--platform", "manylinux_2_28_x86_64", "--implementation", "cp", "--python-version", "312", "--abi", "cp312")
_ONLY = ("--no-deps", "--only-binary", ":all:")


def package_folder() -> Path | None:
    """Where the package mediapipe is installed, None where it is not. It is not imported: that takes 0.6 s."""
    spec = importlib.util.find_spec("mediapipe")  # of a top-level package: finds, does not import
    folders = list(spec.submodule_search_locations or []) if spec else []
    return Path(folders[0]) if folders else None


def data_folder() -> Path:
    """Where `lfpipe models get` keeps the networks; need not exist."""
    import platformdirs

    return Path(platformdirs.user_data_dir("lfpipe")) / "models"


def find_model(relative: str) -> Path | None:
    """A file of the mediapipe wheel, as "modules/face_landmark/face_landmark.tflite": the package's, else the data folder's."""
    folder = package_folder()
    if folder is not None and (folder / relative).is_file():
        return folder / relative
    path = data_folder() / Path(relative).name
    return path if path.is_file() else None


def remedy(path: Path) -> str:
    """What to do about a network that is damaged. path: where it is."""
    folder = package_folder()
    if folder is not None and path.is_relative_to(folder):
        return f"`pip install --force-reinstall {PACKAGE}`, the last version that carries the face networks"
    return REMEDY


def missing_models() -> list[str]:
    """The networks of SHA256 that are nowhere on this machine."""
    return [relative for relative in SHA256 if find_model(relative) is None]


def install_models(wheel: Path) -> Path:
    """Takes the networks out of a wheel, or a folder that it was unpacked into; returns the data folder.

    Raises UserError where a file is missing or has other contents, and where the folder cannot be written. The data folder then
    stays as it was.
    """
    contents = {relative: _read(wheel, f"mediapipe/{relative}") for relative in SHA256}
    for relative, content in contents.items():
        found = hashlib.sha256(content).hexdigest()
        if found != SHA256[relative]:
            raise UserError(f"{wheel}: {relative}: SHA-256 {found}, wanted {SHA256[relative]}", f"a wheel of {PACKAGE}")
    folder = data_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for relative, content in contents.items():
            with replaced(folder / Path(relative).name) as file:
                file.write(content)
    except OSError as error:
        raise UserError(f"{folder}: {reason(error)}", "free disk space, and write access to this folder") from None
    return folder


def _read(wheel: Path, name: str) -> bytes:
    """One file of a wheel. Raises UserError."""
    wanted = f"a wheel of {PACKAGE}, for any platform"
    try:
        if wheel.is_dir():
            with (wheel / name).open("rb") as file:
                return file.read(MOST_BYTES)
        check_regular(wheel)
        with zipfile.ZipFile(wheel) as archive, archive.open(name) as file:
            return file.read(MOST_BYTES)
    except (KeyError, FileNotFoundError):
        if not wheel.exists():
            raise UserError(f"{wheel}: there is no such file", wanted) from None
        raise UserError(f"{wheel}: has no {name}", wanted) from None
    except OSError as error:
        raise UserError(f"{wheel}: {reason(error)}", wanted) from None
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        # zipfile raises NotImplementedError for compression it does not know, RuntimeError for encryption
        raise UserError(f"{wheel}: not a wheel: {error}", wanted) from None


def installers(folder: Path) -> list[list[str]]:
    """Commands that put the wheel, or what is in it, into folder: one for each installer of this machine, the surest first."""
    uv = os.environ.get("UV") or shutil.which("uv")
    alone = shutil.which("pip") or shutil.which("pip3")
    pip = [sys.executable, "-m", "pip"] if importlib.util.find_spec("pip") else [alone] if alone else []
    found = [[uv, "pip", "install", "--python", sys.executable, "--target", str(folder), *_UV, *_ONLY, PACKAGE]] if uv else []
    return found + ([[*pip, "download", "--dest", str(folder), *_PIP, *_ONLY, PACKAGE]] if pip else [])


def fetch_models(say: Callable[[str], None]) -> Path:
    """Fetches the wheel and takes the networks out; returns the data folder. say: told what happens, once per step.

    Raises UserError where no installer is there, or none of them gets the wheel. An installer shows its own progress where
    stderr is a terminal.
    """
    shown = sys.stderr is not None and sys.stderr.isatty()
    why = "neither uv nor pip is installed here"
    with tempfile.TemporaryDirectory(prefix="lfpipe-models-") as name:
        folder = Path(name)
        for command in installers(folder):
            say(f"models  fetching the face networks by {Path(command[0]).stem}: the wheel of {PACKAGE}, 36 MB, once")
            try:
                done = subprocess.run(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=None if shown else subprocess.PIPE)
            except OSError as error:
                why = f"{command[0]}: {reason(error)}"
                continue
            if done.returncode == 0:
                wheel = next(folder.glob("*.whl"), folder)
                kept = install_models(wheel)
                say(f"models  kept in {kept}")
                return kept
            last = (done.stderr or b"").decode(errors="replace").strip()[-300:]
            why = f"`{Path(command[0]).name}` ended with code {done.returncode}{': ' if last else ''}{last}"
    raise UserError(f"the face networks could not be fetched: {why}", REMEDY)
