"""Checks whether `lfpipe up SCENE` would run on this machine, each check with its remedy, and packs
a bug report. Opens no window, and starts no camera.
"""

import contextlib
import errno
import io
import json
import os
import platform
import shutil
import sys
import zipfile
from pathlib import Path

import attrs

from lfpipe import config, log
from lfpipe.capture.camera_list import CameraDevice, asking, cameras, ranked
from lfpipe.capture.open_source import check_source
from lfpipe.config import SessionOptions
from lfpipe.config.check import commented
from lfpipe.config.session_options import NoViewer
from lfpipe.errors import UserError, redacted
from lfpipe.files.safe_files import PRIVATE, check_output, write_output
from lfpipe.host.files import is_missing
from lfpipe.host.worker import install_command, usable_cores, versions
from lfpipe.render.display.display import has_display
from lfpipe.scene.pack import prepare_cache
from lfpipe.supervisor import rundir
from lfpipe.supervisor.session import try_session
from lfpipe.track import models
from lfpipe.transport.control import MANIFEST, Session, base_dir

NO_CAMERA = (
    "plug it in, or use --camera mouse, --camera demo, or a recording with --camera file:PATH"
)


@attrs.frozen
class Check:
    """The result of a check."""

    name: str
    ok: bool
    """False if `lfpipe up SCENE` would fail with any --display."""
    detail: str
    remedy: str = ""
    """With ok: a possible improvement."""


def python() -> Check:
    """The interpreter, and the cores that it may use."""
    count = len(usable_cores())
    return Check(
        "python",
        True,
        f"{platform.python_version()} ({platform.python_implementation()}, {sys.executable}),"  # noqa: TID251
        f" {count} cores",
        "" if count > 1 else "use at least two cores; on one, the rates are lower",
    )


def face_networks() -> Check:
    """The model files, or the way in which they will be fetched."""
    if not (missing := models.missing_models()):
        folders = {
            str(path.parent) for relative in models.SHA256 if (path := models.find_model(relative))
        }
        return Check("models", True, f"in {', '.join(sorted(folders))}")
    names = ", ".join(Path(relative).name for relative in missing)
    if command := models.installer(Path()):
        by = Path(command[0]).name
        return Check(
            "models",
            True,
            f"not fetched yet: {names}; the first `lfpipe up` fetches them with {by}",
            models.REMEDY,
        )
    return Check(
        "models",
        False,
        f"missing: {names}; neither uv nor pip is installed to fetch them",
        models.REMEDY,
    )


def sdl() -> Check:
    """SDL's video driver and how it presents pictures."""
    if not has_display():
        remedy = (
            "run on a desktop, or use --display none or --display file:OUT.mkv; `lfpipe up --demo`"
            " needs none"
        )
        # CI and servers replay, record and measure without a screen
        return Check("display", True, "no screen here", remedy)
    try:
        from lfpipe.render.display.window_system import detect_monitors, drawn_by, pygame

        driver, monitors = detect_monitors()
    except Exception as error:  # the user needs to see any SDL error
        remedy = f"{install_command('--force-reinstall', 'pygame-ce')}, or use --display none"
        return Check("display", False, f"SDL does not start: {error}", remedy)
    version = ".".join(map(str, pygame.version.SDL))
    listed = "; ".join(f"monitor {monitor}" for monitor in monitors)
    return Check("display", True, f"SDL {version}, driver {driver}, {drawn_by(driver)}; {listed}")


def settings() -> Check:
    """The user's own settings, which every command reads."""
    path = config.user_file()
    try:
        config.load()
    except UserError as error:
        return Check("settings", False, error.message, error.remedy)
    return Check("settings", True, f"none ({path}): defaults" if is_missing(path) else str(path))


def camera_checks(source: str, devices: list[CameraDevice]) -> list[Check]:
    """All cameras; `lfpipe up` uses the first. source: camera.source of the settings."""
    if source and not source.startswith("camera:"):
        return [Check("camera", True, f"camera.source is {source}"), *map(camera, devices)]
    if not devices and not source:
        return [Check("camera", True, "none: over the window, the mouse is the viewer")]
    if not devices:
        return [Check("camera", False, f"none, but camera.source is {source}", NO_CAMERA)]
    first, *others = (camera(device) for device, _ in ranked(devices))
    return [first if source else attrs.evolve(first, ok=not first.remedy), *others]


def camera(device: CameraDevice) -> Check:
    """One camera with its formats."""
    name = f"{device.path} {device.name}".strip()
    try:
        offered = " ".join(asking(device.path, lambda opened: opened.fourccs()))
    except PermissionError:
        return Check(
            "camera",
            True,
            f"{name}: no permission",
            "add yourself to the group `video` and log in again",
        )
    except OSError as error:
        if error.errno == errno.ENOTSUP:
            return Check("camera", True, f"{name}: formats are not known here")
        return Check(
            "camera",
            True,
            f"{name}: {error.strerror}",
            f"close the program that uses it: `fuser -v {device.path}` shows it",
        )
    return Check("camera", True, f"{name}: {offered or 'formats unknown'}")


def cache(scene: config.Scene) -> Check:
    """The folder for packs of scenes."""
    try:
        return Check("cache", True, str(prepare_cache(scene)))
    except UserError as error:
        return Check("cache", False, error.message, error.remedy)


def session(settings: config.Config) -> Check:
    """Starts a session on the demo's camera and ends it: memory, sockets, and with face networks
    processes.
    """
    # mediapipe is optional: sessions use litert without it
    settings = attrs.evolve(settings, track=attrs.evolve(settings.track, engine="litert"))
    try:
        viewer = NoViewer() if models.missing_models() else check_source("demo", settings.camera)
        outcome = try_session(
            Session(f"doctor.{os.getpid()}"), settings, SessionOptions(viewer=viewer, show=False)
        )
        total_bytes, _, free_bytes = shutil.disk_usage(base_dir())
    except UserError as error:
        return Check("session", False, error.message, error.remedy)
    if outcome.failure is not None:
        return Check("session", False, outcome.failure, outcome.remedy)
    assert outcome.final is not None, "it had started"
    room = f"{base_dir()}: {free_bytes / 1e6:.0f} MB free of {total_bytes / 1e6:.0f} MB"
    started = ", ".join(outcome.final.used_stages) or "nothing"
    return Check("session", True, f"started and ended: {started}; {room}")


def checks() -> list[Check]:
    """All checks, in the order in which to fix problems."""
    settings_check = settings()
    settings_used = config.load() if settings_check.ok else config.Config()
    return [
        python(),
        settings_check,
        face_networks(),
        sdl(),
        *camera_checks(settings_used.camera.source, cameras()),
        cache(settings_used.scene),
        session(settings_used),
    ]


def write_report(path: Path, results: list[Check], overwrite: bool = False) -> None:
    """Writes a ZIP file with versions, settings, the checks, and the log and state of the user's
    sessions, private to its owner. Raises UserError.
    """
    check_output(path, overwrite=overwrite, label="--report")
    contents: dict[str, str | bytes] = {
        "versions.json": json.dumps({**versions(), "system": platform.platform()}, indent=1),
        "doctor.txt": "\n".join(
            f"{'' if one.ok else 'FAIL '}{one.name}: {one.detail}; {one.remedy}" for one in results
        ),
    }
    try:
        contents["config.toml"] = redacted(commented(config.load()))
    except UserError as error:
        contents["config.txt"] = str(error)
    with contextlib.suppress(OSError):
        contents[log.last_file().name] = log.last_file().read_bytes()
    for name in rundir.running():
        run_dir = Session(name).run_dir
        with contextlib.suppress(OSError):  # it has just ended
            contents[f"{name}/{MANIFEST}"] = (run_dir / MANIFEST).read_bytes()
            contents[f"{name}/{log.FILE}"] = log.lines(run_dir)
            contents |= {
                f"{name}/{stack.name}": stack.read_bytes()
                for stack in sorted(run_dir.glob("stack.*"))
            }
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as report:
        for name, content in contents.items():
            report.writestr(name, content)
    write_output(path, data.getvalue(), PRIVATE, label="--report")
