"""Sessions as objects: one that a program starts, or one that runs already. Frames and eyes come
from shared memory. And replays, in a process of their own.
"""

import contextlib
import json
import os
import re
import subprocess
import time
import weakref
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.api.scenes import ArrayLike, Closing, Eyes, Number, ScenePath, scene_path, typed
from lfpipe.config import Config, Snapshot, converter, updated
from lfpipe.errors import ERROR_FILE, UserError
from lfpipe.host import signals
from lfpipe.host.files import exists
from lfpipe.host.worker import NULL, Child, python
from lfpipe.monitor.session_reader import Watch
from lfpipe.render.display.display import has_display
from lfpipe.scene.lightfield import LightField
from lfpipe.supervisor.rundir import find
from lfpipe.track.eye_tracker import HeadEstimator
from lfpipe.transport import control
from lfpipe.transport.ring import POLL_S, Reader, Stamp
from lfpipe.transport.status import State

CHECK = "check this machine with `lfpipe doctor`"
STOPPED = (0, -signals.END, 128 + signals.END)  # exit codes of a session that did not fail
START_S = 600.0  # a scene may be packed first
_PARAMETERS = {  # what a command's messages call them, and what replaces it
    r"--session( NAME)?\b": "name",
    r"--set ([\w.]+)=(-?[\d.]+)(?![\w.])": r"settings={'\1': \2}",
    r"--set ([\w.]+)=([^\s,;)]+)": r"settings={'\1': '\2'}",
    r"--(camera|display|trace) '?([^\s,;']*[^\s,;':])'?": r"\1='\2'",
    r"--(camera|display|trace)\b": r"\1",
}
STOP_S = 30.0  # a recording is completed at the end


@attrs.frozen(eq=False)
class Frame:
    """A camera frame."""

    picture: NDArray[np.uint8]
    """uint8 (height, width, 3) BGR, a copy."""
    stamp: Stamp
    """source_seq, t_sensor_ns, t_read_ns, skipped, ..."""


class Attachment(Closing):
    """A running session: reads its newest data, where a slow reader skips frames, and sends
    commands.

    Parameters
    ----------
    session : str
        Its name, as `lfpipe up --session`.

    Raises
    ------
    UserError
        If no session of that name runs.
    """

    @typed
    def __init__(self, session: str = "default") -> None:
        self.name = session
        self._session = find(session)
        self._readers: dict[str, Reader] = {}
        self._closed = False
        self._watch = Watch(self._session)
        try:
            self._estimator = HeadEstimator(self._config())
        except BaseException:
            self.close()
            raise

    def _require_session(self) -> None:
        """Raises UserError once the session has ended, or this object was closed."""
        if self._closed:
            raise UserError(f"session {self.name!r} was closed here", "attach again")
        if not self._watch.is_running():
            raise UserError(f"session {self.name!r} has ended{self._end()}", "start another one")

    def _end(self) -> str:
        """How the session ended, after a colon; empty if that is not known."""
        return ""

    def _config(self) -> Config:
        return converter().structure(self.ask({"cmd": "hello"}), Snapshot).config

    @typed
    def frame(self, timeout_s: Number = 2.0) -> Frame:
        """The next camera frame.

        Parameters
        ----------
        timeout_s : float

        Returns
        -------
        Frame

        Raises
        ------
        UserError
            If none arrives in time.
        """
        picture: NDArray[np.uint8] = np.empty(self._reader("frames").shape, np.uint8)
        return Frame(picture, self._next("frames", picture, timeout_s))

    @typed
    def eyes(self, timeout_s: Number = 2.0) -> Eyes | None:
        """The eyes of the next frame.

        Parameters
        ----------
        timeout_s : float

        Returns
        -------
        Eyes or None
            None if the frame shows no face.

        Raises
        ------
        UserError
            If no frame arrives in time.
        """
        record = np.zeros((), self._reader("eyes").dtype)
        stamp = self._next("eyes", record, timeout_s)
        self._estimator.update(record, stamp.t_sensor_ns)
        return Eyes.of(record, stamp.t_sensor_ns, self._estimator.head(record))

    def stream(self) -> Iterator[Eyes | None]:
        """Yields `eyes` until the session ends."""
        while not self._closed and self._watch.is_running():
            with contextlib.suppress(UserError):
                yield self.eyes()

    def _reader(self, ring: str) -> Reader:
        self._require_session()
        if ring not in self._readers:
            try:
                self._readers[ring] = Reader(self._session.segment(ring))
            except FileNotFoundError:
                raise UserError(
                    f"session {self.name!r} has no {ring}: no camera is in use",
                    "start it with a camera",
                ) from None
        return self._readers[ring]

    def _next(self, ring: str, out: NDArray[Any], timeout_s: float) -> Stamp:
        end = time.monotonic() + timeout_s
        while (stamp := self._reader(ring).read(out)) is None:
            if time.monotonic() > end:
                raise UserError(
                    f"session {self.name!r} sent nothing new for {timeout_s:g} s",
                    "see why with `lfpipe monitor`",
                )
            time.sleep(POLL_S)
        return stamp

    def status(self) -> dict[str, Any]:
        """State and latency of every stage, as `lfpipe monitor --once --json` prints it."""
        self._require_session()
        return self._watch.read().to_dict()

    @typed
    def ask(self, message: control.Message, timeout_s: Number = 3.0) -> control.Message:
        """Sends a command (docs/contracts.md).

        Parameters
        ----------
        message : mapping
            For example {"cmd": "pause"}.
        timeout_s : float

        Returns
        -------
        dict
            The answer.

        Raises
        ------
        UserError
            If it is refused, or if the session has ended.
        """
        self._require_session()
        return control.request(self._session.run_dir, message, timeout_s)

    @typed
    def set(self, settings: Mapping[str, Any]) -> None:
        """Changes configuration keys: all of them, or none if one is refused.

        Parameters
        ----------
        settings : mapping
            For example {"render.method": "nearest"}.

        Raises
        ------
        UserError
            If one is refused.
        """
        self.ask({"cmd": "set", "set": dict(settings)})

    def load(self, scene: ScenePath | LightField | ArrayLike) -> None:
        """Shows another light field; returns when it is shown.

        Parameters
        ----------
        scene : path, LightField or array_like
            As for `open_scene`.

        Raises
        ------
        UserError
            If it cannot be shown; the current one then stays.
        """
        path = Path(scene_path(scene, self._config().scene) or "")
        self.ask({"cmd": "load", "scene": str(path.resolve())}, control.LOAD_TIMEOUT_S)

    @typed
    def wait(self, timeout_s: Number | None = None) -> bool:
        """Waits until the session has ended; returns False if it still runs after timeout_s."""
        end = None if timeout_s is None else time.monotonic() + timeout_s
        if self._closed:
            self._require_session()
        while self._watch.is_running():
            if end is not None and time.monotonic() > end:
                return False
            time.sleep(0.02)
        return True

    def stop(self) -> None:
        """Ends the session, and returns when it has left nothing behind. May be called again."""
        if self._closed:
            return
        with contextlib.suppress(UserError):  # it has ended
            self.ask({"cmd": "stop"})
        self.wait(STOP_S)

    def close(self) -> None:
        """Detaches; the session continues. May be called again."""
        if self._closed:
            return
        self._closed = True
        for reader in self._readers.values():
            reader.close()
        self._readers.clear()
        self._watch.close()


class Session(Attachment):
    """A session that this program starts, as `lfpipe up` does. It ends with `stop`, with the block,
    or with the program. Works in a notebook and in any thread.

    Parameters
    ----------
    scene : path, LightField or array_like, optional
        As for `open_scene`; by default the demo's.
    camera, display : str, optional
        As `--camera` and `--display`. Without a screen, the display is "none".
    name : str, optional
        For `attach` and `lfpipe monitor --session`.
    trace : path, optional
        A file of one line per picture.
    settings : mapping, optional
        As for `--set`, for example {"render.method": "warp2"}.

    Raises
    ------
    UserError
        If the session does not start.
    TypeError
        For an argument of another type.

    Examples
    --------
    >>> with Session(display="none") as session:
    ...     session.set({"render.method": "nearest"})
    """

    @typed
    def __init__(
        self,
        scene: ScenePath | LightField | ArrayLike | None = None,
        *,
        camera: str | None = None,
        display: str | None = None,
        name: str | None = None,
        trace: str | os.PathLike[str] | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        settings = dict(settings or {})
        path = scene_path(scene, updated(Config(), settings).scene)
        if isinstance(scene, LightField) and scene.depth_inverted:
            settings.setdefault("scene.invert_depth", "yes")
        # short: it is part of a socket's path
        name = name or f"py{os.getpid()}.{time.monotonic_ns() % 1000}"
        display = display or ("window" if has_display() else "none")
        words = _command_line(
            "up",
            "--demo" if path is None else str(path.resolve()),
            settings,
            session=name,
            camera=camera,
            display=display,
            trace=trace,
        )
        self._cleanup = contextlib.ExitStack()
        folder = Path(self._cleanup.enter_context(TemporaryDirectory(prefix="lfpipe-session-")))
        self._error_file = folder / "error.json"
        self._error = UserError("the session ended at once", CHECK)  # if it leaves none
        self._closed = True  # nothing is open yet
        self._process = Child(
            python("lfpipe.host.worker", "lfpipe", *words),
            stdout=NULL,
            stderr=NULL,
            env={**os.environ, ERROR_FILE: str(self._error_file)},
            start_new_session=True,  # signals of the terminal do not reach it
        )
        assert self._process.stdin is not None
        # of an object that is garbage, the session ends, too: with its standard input
        weakref.finalize(self, self._process.stdin.close)
        try:
            self._wait_for_start(name)
        except BaseException:
            self.stop()
            raise

    def _wait_for_start(self, name: str) -> None:
        end = time.monotonic() + START_S
        while time.monotonic() < end:
            if self._process.poll() is not None:
                raise self._failure()
            with contextlib.suppress(UserError, FileNotFoundError):
                super().__init__(name)
                # else this name is already taken
                is_own = self._watch.manifest.pid == self._process.pid
                rows = self._watch.table.rows  # no row itself: `close` could not unmap it
                if is_own and rows["render"]["state"] == State.RUNNING and rows["render"]["seq"]:
                    return
                self.close()
            time.sleep(0.05)
        raise UserError(
            f"session {name!r} did not start within {START_S:g} s", "see why with `lfpipe monitor`"
        )

    def _failure(self) -> UserError:
        if exists(self._error_file):
            self._error = UserError.from_json(self._error_file.read_bytes()) or self._error
        self._cleanup.close()
        return UserError(_by_parameter(self._error.message), _by_parameter(self._error.remedy))

    def _end(self) -> str:
        if self._process.wait_at_most(STOP_S) in STOPPED:
            return ": it was stopped, or its source ended"
        return f": {self._failure().message}"

    @typed
    def wait(self, timeout_s: Number | None = None) -> bool:
        """Waits until the session has ended; returns False if it still runs after timeout_s.

        Raises
        ------
        UserError
            If it failed.
        """
        code = self._process.wait_at_most(timeout_s)
        if code is None:
            return False
        if code not in STOPPED:
            raise self._failure()
        return True

    def stop(self) -> None:
        """Ends the session, and returns when it has left nothing behind. May be called again."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        # a program that was started from here may hold the standard input open
        self._process.send_signal(signals.END)
        self._process.wait_at_most(STOP_S)
        self._process.close()
        self._failure()  # keeps the error, and removes the file

    def __exit__(self, *_: object) -> None:
        self.stop()
        self.close()


attach = Attachment


@typed
def replay(
    sequence: str | os.PathLike[str],
    scene: ScenePath | LightField | ArrayLike | None = None,
    *,
    pace: str = "step",
    out: str | os.PathLike[str] | None = None,
    settings: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Runs `lfpipe replay` on a recorded sequence, in a process of its own.

    Parameters
    ----------
    sequence : path
        A recorded sequence, or a video.
    scene : path, LightField or array_like, optional
        As for `open_scene`; by default the demo's.
    pace : str
        "step", "max", "recorded" or a rate in Hz.
    out : path, optional
        A folder for report, trace and pictures.
    settings : mapping, optional
        As for `--set`; they override the user's file.

    Returns
    -------
    dict
        The contents of report.json (docs/replay.md).

    Raises
    ------
    UserError
        If the command refuses or fails.
    TypeError
        For an argument of another type.
    """
    path = scene_path(scene, updated(Config(), settings or {}).scene)
    with TemporaryDirectory(prefix="lfpipe-replay-") as folder:
        error_file = Path(folder, "error.json")
        results = Path(folder, "out") if out is None else Path(out)
        words = _command_line(
            "replay", str(sequence), settings or {}, pace=pace, out=results, scene=path
        )
        done = subprocess.run(
            python("lfpipe", *words),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, ERROR_FILE: str(error_file)},
            check=False,
        )
        if done.returncode != 0:
            error = UserError.from_json(error_file.read_bytes()) if exists(error_file) else None
            raise error or UserError("the replay was killed", CHECK)
        report: dict[str, Any] = json.loads((results / "report.json").read_text())
        return report


def _command_line(
    command: str,
    what: str,
    settings: Mapping[str, Any],
    **options: str | os.PathLike[str] | None,
) -> list[str]:
    """The arguments of a command about `what`, without the options that are None."""
    texts = {name: os.fspath(value) for name, value in options.items() if value is not None}
    sets = (f"--set={key}={json.dumps(value)}" for key, value in settings.items())
    return [command, what, *(f"--{name}={value}" for name, value in texts.items()), *sets]


def _by_parameter(text: str) -> str:
    """A command's message about its options, as one about the parameters of `Session`. What stands
    in backticks remains: it is typed in a terminal.
    """
    parts = text.split("`")
    for option, parameter in _PARAMETERS.items():
        parts[::2] = [re.sub(option, parameter, part) for part in parts[::2]]
    return "`".join(parts)
