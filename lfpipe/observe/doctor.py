"""Checks whether `lfpipe up SCENE` would run on this machine, each check with its remedy. Starts no camera, opens no window."""

import errno
import importlib.metadata
import importlib.util
import os
import platform
import re
import sys
from pathlib import Path

import attrs

from lfpipe import config
from lfpipe.capture.camera_list import CameraDevice, asking, cameras
from lfpipe.errors import UserError
from lfpipe.host import shared_memory as memory
from lfpipe.host.files import exists, is_missing
from lfpipe.host.processes import usable_cores
from lfpipe.plugins import GROUPS, Plugin, plugins
from lfpipe.render.display import has_display
from lfpipe.track import models

NO_CAMERA = "plug one in, or use --camera demo, or a recording with --camera file:PATH; `lfpipe up --demo` needs none"
SHM_NEED_BYTES = 16 << 20  # rings for frames of 640x480, with a margin


@attrs.frozen
class Check:
    """ok is False if plain `lfpipe up SCENE` would fail. A remedy with ok = True suggests an improvement."""

    name: str
    ok: bool
    detail: str
    remedy: str = ""


def python() -> Check:
    """The interpreter, and the cores that it may use."""
    count = len(usable_cores())
    detail = f"{platform.python_version()} ({platform.python_implementation()}, {sys.executable}), {count} cores"
    return Check("python", True, detail, "" if count > 1 else "use at least two cores; on one, the rates are lower")


def plugin_check(plugin: Plugin) -> Check:
    """What another package adds; sessions skip a broken one."""
    what = f"{plugin.group.removeprefix('lfpipe.').removesuffix('s')} {plugin.name}, from {plugin.package}"
    try:
        plugin.load()
    except UserError as error:
        return Check("plugin", True, f"{what}: skipped: {error.message}", error.remedy)
    return Check("plugin", True, what)


def opencv_distributions() -> list[str]:
    """Installed distributions that provide `cv2`, as "name version"."""
    found = {((dist.name or "").lower(), dist.version) for dist in importlib.metadata.distributions()}
    return sorted(f"{name} {version}" for name, version in found if name.startswith("opencv-"))


def opencv(distributions: list[str]) -> Check:
    """Whether cv2 can be imported, which distributions provide it, and its GUI backend.

    MediaPipe requires the windowed distribution, whose files overlap with the headless one's: pip installs both, and the last
    one wins. The remedy puts the headless files on top, in the oldest version, which fits the installed numpy.
    """
    names = ", ".join(distributions) or "no distribution"
    versions = sorted({name.split()[1] for name in distributions}, key=lambda text: [int(n) for n in re.findall(r"\d+", text)])
    reinstall = "pip install --force-reinstall --no-deps opencv-contrib-python-headless"
    reinstall += f"=={versions[0]}" if versions else ""
    try:
        import cv2

        build = cv2.getBuildInformation()
    except (ImportError, AttributeError) as error:
        return Check("opencv", False, f"{names}: cv2 cannot be imported: {error}", reinstall)
    gui = next((line.split(":", 1)[1].strip() for line in build.splitlines() if line.strip().startswith("GUI:")), "?")
    if len(distributions) > 1 and (len(versions) > 1 or gui != "NONE"):
        doubled = f"{names}: {len(distributions)} in one folder, cv2 {cv2.__version__} is in use, GUI {gui}"
        return Check("opencv", False, doubled, reinstall)
    return Check("opencv", True, f"{names}, GUI {gui}")


def face_networks() -> Check:
    """The model files, or how they will be fetched."""
    if not (missing := models.missing_models()):
        folders = {str(path.parent) for relative in models.SHA256 if (path := models.find_model(relative))}
        return Check("models", True, f"in {', '.join(sorted(folders))}")
    names = ", ".join(Path(relative).name for relative in missing)
    if installers := models.installers(Path()):
        by = Path(installers[0][0]).name
        return Check("models", True, f"not fetched yet: {names}; the first `lfpipe up` fetches them with {by}", models.REMEDY)
    return Check("models", False, f"missing: {names}; neither uv nor pip is installed to fetch them", models.REMEDY)


def litert() -> Check:
    """track.engine = litert: runs the model once."""
    if importlib.util.find_spec("ai_edge_litert") is None:
        return Check("litert", False, "not installed", "pip install ai-edge-litert, or --set track.engine=mediapipe")
    from lfpipe.track.litert_engine import LitertEngine

    version = importlib.metadata.version("ai-edge-litert")
    if models.missing_models():
        return Check("litert", True, f"{version}, not run: its face networks are missing")
    try:
        return Check("litert", True, f"{version}, track.engine litert runs {LitertEngine().model}")
    except UserError as error:
        return Check("litert", False, f"{version}: {error.message}", error.remedy)


def sdl() -> Check:
    """SDL's video driver and how it presents pictures."""
    if not has_display():
        remedy = "run on a desktop, or use --display none or --display file:OUT.mkv; `lfpipe up --demo` needs none"
        return Check("display", False, "no screen here", remedy)
    try:
        from lfpipe.render import window_system
        from lfpipe.render.monitors import detect_monitors

        driver, monitors = detect_monitors()
    except Exception as error:  # any error of SDL is what the user needs to read
        remedy = "pip install pygame-ce (and uninstall pygame), or use --display none"
        return Check("display", False, f"SDL does not start: {error}", remedy)
    listed = "; ".join(f"monitor {monitor}" for monitor in monitors)
    how = window_system.drawn_by(driver)
    return Check("display", True, f"SDL {window_system.version()}, driver {driver}, {how}; {listed}")


def settings() -> Check:
    """The user's own settings, which every command reads."""
    path = config.user_file()
    try:
        config.load()
    except UserError as error:
        return Check("settings", False, error.message, error.remedy)
    return Check("settings", True, f"none ({path}): defaults" if is_missing(path) else str(path))


def camera_checks(source: str, found: list[CameraDevice]) -> list[Check]:
    """All cameras; `lfpipe up` uses the first. source: camera.source of the settings."""
    if source and not source.startswith("camera:"):
        return [Check("camera", True, f"camera.source is {source}"), *map(camera, found)]
    if not found:
        return [Check("camera", False, "none", NO_CAMERA)]
    first, *others = map(camera, found)
    return [attrs.evolve(first, ok=source != "" or not first.remedy), *others]


def camera(device: CameraDevice) -> Check:
    """One camera with its formats."""
    name = f"{device.path} {device.name}".strip()
    try:
        offered = " ".join(asking(device.path, lambda opened: opened.fourccs()))
    except PermissionError:
        return Check("camera", True, f"{name}: no permission", "add yourself to the group `video` and log in again")
    except OSError as error:
        if error.errno == errno.ENOTSUP:
            return Check("camera", True, f"{name}: formats are not known here")
        return Check("camera", True, f"{name}: {error.strerror}", f"`fuser -v {device.path}` shows which program uses it")
    return Check("camera", True, f"{name}: {offered or 'formats unknown'}")


def shared_memory(need_bytes: int = SHM_NEED_BYTES) -> Check:
    """Free shared memory for the rings."""
    remedy = memory.more_room(need_bytes)
    try:
        free, total = memory.room()
    except OSError as error:
        return Check("shm", False, f"{memory.SHM_DIR}: {error.strerror}", remedy)
    ok = free >= need_bytes and (not exists(memory.SHM_DIR) or os.access(memory.SHM_DIR, os.W_OK))
    return Check("shm", ok, f"{memory.SHM_DIR}: {free / 1e6:.0f} MB free of {total / 1e6:.0f} MB", "" if ok else remedy)


def leftovers() -> Check:
    """This user's segments whose session is dead, whatever its run directory."""
    from lfpipe.transport import segment

    if not (run_dirs := dict(segment.abandoned())):
        return Check("left over", True, "nothing")
    places = sorted({str(run_dir.parent) for run_dir in run_dirs.values()})
    remedy = f"run `lfpipe up`, which removes them, with XDG_RUNTIME_DIR={' or '.join(places)}"
    return Check("left over", True, ", ".join(run_dirs), remedy)


def checks() -> list[Check]:
    """All checks, in the order in which to fix problems."""
    own = settings()
    return [
        python(),
        own,
        opencv(opencv_distributions()),
        face_networks(),
        litert(),
        sdl(),
        *camera_checks(config.load().camera.source if own.ok else "", cameras()),
        shared_memory(),
        leftovers(),
        *(plugin_check(plugin) for group in GROUPS for plugin in plugins(group).values()),
    ]
