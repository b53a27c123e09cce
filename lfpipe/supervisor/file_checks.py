"""Access to files and host names in a child process, `python -m lfpipe.supervisor.file_checks`,
because a dead network drive or name server blocks its caller. The child checks paths and hosts, and
saves settings.
"""

import itertools
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs

from lfpipe.errors import UserError
from lfpipe.host.worker import Report, serve
from lfpipe.plugins import REQUESTS, guarded, load
from lfpipe.transport.control import Message

START = "~"  # the folder to begin with
LISTED_BYTES = (
    48 << 10
)  # of the names in a folder, each with 5 for its length: a message holds them
# of a check: the libraries of a recording reserve 300 MB when they are imported
MEMORY_BYTES = 1 << 30


@attrs.frozen(kw_only=True)
class FileCheck:
    """The task of the child for a request."""

    check: str
    """"trace", "record", "viewer", "folder", "keep", "keep depth", "keep focal", or a command of
    another package."""
    path: str
    """Of the output, the settings or the pack; messages name it."""
    source: str = ""
    """The source of frames: an input, which no output may replace."""
    record: str = ""
    """The folder of the running recording, likewise."""
    section: str = ""
    """Settings to write to [section]."""
    values: Mapping[str, Any] = attrs.field(factory=dict)
    """The settings; those of the camera for a viewer, and what was measured of it."""

    @property
    def writes(self) -> bool:
        """Whether it writes a file: such a task is queued instead of refused."""
        return self.check.startswith("keep")


def check(request: Message, _report: Report) -> Message:
    """In the child: the result of a FileCheck as plain values. Raises UserError."""
    asked = FileCheck(**request)
    if asked.check == "trace":
        from lfpipe.capture.spec import source_file
        from lfpipe.files.output import check_output

        inputs = (source_file(asked.source), Path(asked.record) if asked.record else None)
        check_output(Path(asked.path), [source for source in inputs if source is not None])
        return {}
    if asked.check == "record":
        from lfpipe.sequence.folder import check_out

        check_out(Path(asked.path))
        return {}
    if asked.check == "folder":
        return _folder(asked.path)
    if asked.check == "viewer":
        return _viewer(asked)
    if asked.check == "keep":
        from lfpipe.config.user_files import write_keys

        write_keys(Path(asked.path), asked.section, asked.values)
        return {}
    if asked.check == "keep focal":
        from lfpipe.capture.open_source import camera_name
        from lfpipe.config.user_files import keep_focal

        keep_focal(camera_name(asked.source), **asked.values)
        return {}
    if asked.check == "keep depth":
        from lfpipe.scene.inverted_depth import remember
        from lfpipe.scene.pack import open_pack

        remember(open_pack(Path(asked.path)), asked.values["depth"])
        return {}
    plugin = guarded(load(REQUESTS, asked.check, ()), REQUESTS, asked.check, {"check": dict})
    return dict(plugin.check(asked))


def _folder(path: str) -> Message:
    """What there is to open in a folder; for START, in that of the last scene that is no demo, or
    at home.
    """
    from lfpipe.files.safe_files import reason
    from lfpipe.host.files import exists
    from lfpipe.scene.demo import MARKER
    from lfpipe.scene.files import HOLDS_ALL, PICTURES, entries, natural
    from lfpipe.scene.recent_scenes import recent_scenes

    folder = Path(path)
    if path == START:
        own = (scene.parent for scene in recent_scenes() if not exists(scene / MARKER))
        folder = next(own, Path.home())
    try:
        names, folders = entries(folder)
    except OSError as error:
        raise UserError(
            f"{folder}: cannot be read: {reason(error)}", "check the path and its permissions"
        ) from None
    files = [name for name in names if name.lower().endswith((*HOLDS_ALL, *PICTURES))]
    folders, files = sorted(folders, key=natural), sorted(files, key=natural)
    sizes = itertools.accumulate(len(os.fsencode(name)) for name in (*folders, *files))
    count = sum(size + 5 * number <= LISTED_BYTES for number, size in enumerate(sizes, 1))
    return {
        "path": str(folder),
        "folders": folders[:count],
        "files": files[: max(0, count - len(folders))],
        "more": max(0, len(folders) + len(files) - count),
    }


def _viewer(asked: FileCheck) -> Message:
    """The viewer in front of a source."""
    from lfpipe.capture.open_source import check_source
    from lfpipe.config import Camera, converter
    from lfpipe.config.modes import RecordedEyes

    found = check_source(asked.source, converter().structure(asked.values, Camera))
    if isinstance(found, RecordedEyes):
        raise UserError(
            f"{asked.source}: a recording of the mouse cannot replace a viewer",
            "start a session with --camera",
        )
    return {"source": found.source, "rate_hz": found.rate_hz, "jpeg_px": found.jpeg_px}


if __name__ == "__main__":
    serve(check, MEMORY_BYTES)
