"""Runs the real stages on a recorded sequence and writes the results to a folder.

- step: every frame passes every stage before the next one starts; eyes, views and pictures depend
  only on the sequence, the scene and the configuration
- max: as fast as possible; nothing is lost, and the results equal those of step
- recorded, HZ: in real time, on the clocks of a live session; late frames are dropped and counted
"""

import contextlib
import errno
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from lfpipe import config as config_module
from lfpipe.config import Config, SessionOptions
from lfpipe.config.modes import CameraViewer, Live, Lossless, RecordedEyes, ReplayOutput, Viewer
from lfpipe.errors import UserError
from lfpipe.files.output import write_output, written_by_lfpipe
from lfpipe.files.safe_files import PRIVATE_FOLDER, WORK_NAME, reason
from lfpipe.host import signals
from lfpipe.host.file_lock import take_folder
from lfpipe.host.files import is_dir
from lfpipe.render.listeners.replay_writer import PICTURES
from lfpipe.replays.report import DIFFERENCE, REPORT, STEADY, TRACE, Report, make_report
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import summarize
from lfpipe.sequence.folder import MANIFEST
from lfpipe.sequence.folder import Sequence as Recorded
from lfpipe.sequence.packets import COPY, INDEX, PACKETS

_FILE = re.compile(
    r"report\.json|trace\.jsonl|(first|last|worst)\.png|pictures/frames\.(bin|jsonl)"
    r"|difference/frame_\d+_\w+\.png"
)
PLACE = "name a folder that you may write to, on a disk with free space"


class ReplayFailed(Exception):
    """The stages did not reach the end of the sequence; the text explains why."""


def replay_config(sequence: Recorded, file: str | None, sets: tuple[str, ...]) -> Config:
    """The configuration of a replay: the recorded camera, and the user's current settings for
    everything else.

    Raises UserError for a wrong key or value.
    """
    config = config_module.load(file, sets)
    named = {config_module.parse_set(text)[0] for text in sets}
    recorded = sequence.manifest.get("config", {}).get("camera", {})
    camera = {f"camera.{key}": recorded[key] for key in ("focal_px", "fov_deg") if key in recorded}
    size = dict(zip(("width_px", "height_px"), sequence.size_px, strict=True))
    # because its JPEGs may have been scaled
    camera |= {f"camera.{key}": recorded.get(key, own) for key, own in size.items()}
    camera["camera.rate_hz"] = min(max(sequence.measured_hz, 0.1), 1000.0)
    try:
        return config_module.updated(
            config, {key: value for key, value in camera.items() if key not in named}
        )
    except UserError as error:
        what = error.message.removeprefix("configuration: ")
        raise UserError(
            f"{sequence.path / MANIFEST}: config: {what}", f"{COPY}, or override it with --set"
        ) from None


def check_out(folder: Path) -> None:
    """Creates folder if it does not exist.

    Raises UserError if it is not writable, or contains anything but results.
    """
    try:
        folder.mkdir(PRIVATE_FOLDER, parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, "Permission denied")
        _check_results(folder)
    except (OSError, ValueError) as error:
        raise UserError(f"{folder}: cannot be written: {reason(error)}", PLACE) from None


def _check_results(folder: Path) -> None:
    """Raises UserError if a folder contains anything but results of a replay, and OSError."""
    strange = sorted(
        name
        for path in folder.rglob("*")
        if not _is_result(path, name := path.relative_to(folder).as_posix())
    )
    if strange:
        raise UserError(
            f"{folder}: contains {strange[0]}, which is not from a replay",
            "use a new or an empty folder",
        )


def _is_result(path: Path, name: str) -> bool:
    """Whether an entry of a folder is of a replay, by name and content. Raises OSError."""
    if path.is_symlink() or is_dir(path):
        return name in (PICTURES, DIFFERENCE) and not path.is_symlink()
    packets = path.name in (PACKETS, INDEX)  # their contents carry no mark
    known = bool(_FILE.fullmatch(name)) and (packets or written_by_lfpipe(path))
    return known or bool(WORK_NAME.fullmatch(path.name))  # of a killed run


def clear_out(folder: Path) -> None:
    """Removes the results of an earlier run from folder. Raises UserError if that fails."""
    check_out(folder)
    try:
        for path in folder.iterdir():
            shutil.rmtree(path) if is_dir(path) else path.unlink()
    except OSError as error:
        raise UserError(f"{folder}: cannot be written: {reason(error)}", PLACE) from None


def _beside(reference: Path) -> tuple[Path, Path, Path]:
    """The folder of a reference, where its next content is written, and where the old one goes."""
    place = Path(os.path.realpath(reference))
    new, old = (place.with_name(f".{place.name[:200]}.{name}") for name in ("new", "old"))
    return place, new, old


@contextlib.contextmanager
def _held(folder: Path, reference: Path) -> Iterator[None]:
    """Holds the lock of a folder, so that a second update of reference is refused. A file system
    without locks of folders (NFS) goes without. Raises UserError and OSError.
    """
    try:
        lock = take_folder(folder)
    except OSError as error:
        if error.errno not in (errno.EBADF, errno.ENOLCK, errno.EOPNOTSUPP):
            raise
        yield
        return
    if lock is None or not lock.in_place():
        raise UserError(
            f"{reference}: another lfpipe is updating it, or it is another user's",
            "wait until that command has ended, then run this one again",
        )
    try:
        yield
    finally:
        lock.release()


def recover_reference(reference: Path) -> None:
    """Completes an update that was killed: its reference is the old one, or the new one in place.

    Raises UserError if an update is running, a name that the update needs is taken, or a folder
    cannot be written.
    """
    place, new, old = _beside(reference)
    with _writing(reference):
        for left in (new, old):
            if os.path.lexists(left):
                with _held(left, reference):
                    _check_results(left)
                    if left == old and not os.path.lexists(place):
                        old.rename(place)
                    else:
                        shutil.rmtree(left)


@contextlib.contextmanager
def _writing(reference: Path) -> Iterator[None]:
    """Turns errors of writing a reference into UserError."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise UserError(f"{reference}: cannot be written: {reason(error)}", PLACE) from None


@contextlib.contextmanager
def update_of(reference: Path) -> Iterator[Callable[[Path], None]]:
    """Keeps other updates of reference away. Yields a function that replaces reference by a folder
    with those files of a run that a comparison reads.

    Raises UserError if reference could not be written, or anything but results would be removed;
    the function raises it if writing fails: the old reference is then kept. What a killed update
    leaves, `recover_reference` completes. Makes the folders above reference.
    """
    place, new, old = _beside(reference)
    with contextlib.ExitStack() as held:
        with _writing(reference):
            place.parent.mkdir(parents=True, exist_ok=True)
            if not os.access(place.parent, os.W_OK | os.X_OK):
                raise PermissionError(errno.EACCES, "Permission denied")
            recover_reference(reference)
            if os.path.lexists(place):
                check_out(place)
                held.enter_context(_held(place, reference))
            new.mkdir(PRIVATE_FOLDER)
            held.enter_context(_held(new, reference))
            held.callback(shutil.rmtree, new, ignore_errors=True)

        def replace(folder: Path) -> None:
            with _writing(reference):
                for path in (folder / name for name in (REPORT, TRACE, PICTURES)):
                    if is_dir(path):
                        shutil.copytree(path, new / path.name)
                    else:
                        shutil.copy(path, new)
                if os.path.lexists(place):
                    place.rename(old)
                new.rename(place)
                shutil.rmtree(old, ignore_errors=True)

        yield replace


def replay(
    sequence: Recorded,
    field: LightField,
    config: Config,
    pace: str,
    folder: Path,
    pictures: bool,
    tell: Callable[[str], None] = print,
) -> Report:
    """Runs sequence through the stages and writes trace, report and pictures to folder (see
    `clear_out`); returns the report.

    pace: step, max, recorded or a rate in Hz. pictures: store some for comparison. Raises UserError
    for a user error, ReplayFailed if a stage fails, signals.Interrupted.
    """
    from lfpipe.supervisor.session import EndKind, run_session
    from lfpipe.transport.session import Session

    steady = pace in STEADY
    source = f"file:{sequence.path.resolve()}?loop=0&pace={'max' if steady else pace}"
    output = ReplayOutput(str(folder.resolve()), str(sequence.path.resolve()), pictures)
    rate_hz = float(pace) if pace not in ("step", "max", "recorded") else sequence.measured_hz
    # tracked also with a scene of one view: the eyes are compared
    viewer: Viewer = CameraViewer(source=source, rate_hz=rate_hz)
    if sequence.holds_eyes:
        viewer = RecordedEyes(source=source, rate_hz=rate_hz, folder=str(sequence.path.resolve()))
    options = SessionOptions(
        scene=summarize(field),
        viewer=viewer,
        clock=Lossless(lock_step=pace == "step", output=output) if steady else Live(),
        trace=str((folder / TRACE).resolve()),
    )
    outcome = run_session(Session(f"replay.{os.getpid()}"), config, options, tell)
    if outcome.user_error:
        raise UserError(outcome.failure or outcome.reason, outcome.remedy)
    if outcome.kind is EndKind.SIGNAL:
        raise signals.Interrupted(outcome.signum)
    if outcome.failure or outcome.kind is not EndKind.SOURCE_ENDED:
        raise ReplayFailed(outcome.failure or outcome.reason)
    assert outcome.final is not None
    report = make_report(sequence, field, config, pace, folder, outcome.final)
    restarted = [name for name, count in report["counts"]["restarts"].items() if count]
    if restarted:
        raise ReplayFailed(
            f"{', '.join(restarted)} failed during the replay and had to be restarted"
        )
    if steady and report["counts"]["pictures"] != len(sequence.packets):
        raise ReplayFailed(
            f"{report['counts']['pictures']} pictures of {len(sequence.packets)} frames: a stage"
            " lost some"
        )
    write_output(folder / REPORT, json.dumps(report, indent=1).encode() + b"\n")
    return report
