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
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from lfpipe import config as config_module
from lfpipe.config import Config, SessionOptions
from lfpipe.config.modes import CameraViewer, Live, Lossless, RecordedEyes, ReplayOutput, Viewer
from lfpipe.errors import UserError
from lfpipe.files.output import write_output
from lfpipe.files.safe_files import PRIVATE_FOLDER, WORK_NAME, reason
from lfpipe.host import signals
from lfpipe.host.files import is_dir
from lfpipe.render.listeners import PICTURES
from lfpipe.replays.report import DIFFERENCE, REPORT, STEADY, TRACE, Report, make_report
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.pack import summarize
from lfpipe.sequence.folder import MANIFEST
from lfpipe.sequence.folder import Sequence as Recorded
from lfpipe.sequence.packets import COPY

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
    with _writing(folder):
        folder.mkdir(PRIVATE_FOLDER, parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, "Permission denied")
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
    """Whether an entry of a folder is of a replay, by its name."""
    if path.is_symlink() or is_dir(path):
        return name in (PICTURES, DIFFERENCE) and not path.is_symlink()
    return bool(_FILE.fullmatch(name) or WORK_NAME.fullmatch(path.name))  # of a killed run


@contextlib.contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Turns errors of writing a folder into UserError."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise UserError(f"{folder}: cannot be written: {reason(error)}", PLACE) from None


def clear_out(folder: Path) -> None:
    """Removes the results of an earlier run from folder. Raises UserError if that fails."""
    check_out(folder)
    with _writing(folder):
        for path in folder.iterdir():
            shutil.rmtree(path) if is_dir(path) else path.unlink()


def update_reference(reference: Path, folder: Path) -> None:
    """Replaces reference by a folder with those files of a run that a comparison reads.

    Raises UserError if that fails; the old reference is then kept.
    """
    place = Path(os.path.realpath(reference))
    with _writing(reference), tempfile.TemporaryDirectory(dir=place.parent) as work:
        new, old = Path(work, "new"), Path(work, "old")
        new.mkdir(PRIVATE_FOLDER)
        for path in (folder / name for name in (REPORT, TRACE, PICTURES)):
            if is_dir(path):
                shutil.copytree(path, new / path.name)
            else:
                shutil.copy(path, new)
        place.rename(old)
        new.rename(place)


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
    from lfpipe.supervisor.session import run_session
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
    if outcome.signum:
        raise signals.Interrupted(outcome.signum)
    if outcome.failure or not outcome.source_ended:
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
