"""Access to files and host names in a child process, `python -m lfpipe.supervisor.file_checks`,
because a dead network drive or name server blocks its caller. The child checks paths and hosts, and
saves settings.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs

from lfpipe.errors import UserError
from lfpipe.host.worker import Report, serve
from lfpipe.plugins import REQUESTS, guarded, load
from lfpipe.transport.control import Message

FIX_SETTINGS = "make that file writable; if it is damaged, correct it or remove it"
# of a check: the libraries of a recording reserve 300 MB when they are imported
MEMORY_BYTES = 1 << 30


@attrs.frozen(kw_only=True)
class FileCheck:
    """The task of the child for a request."""

    check: str
    """"trace", "record", "viewer", "keep", "keep depth", or a command of another package."""
    path: str
    """Of the output, the settings or the pack; messages name it."""
    source: str = ""
    """The source of frames: an input, which no output may replace."""
    record: str = ""
    """The folder of the running recording, likewise."""
    section: str = ""
    """Settings to write to [section]."""
    values: Mapping[str, Any] = attrs.field(factory=dict)
    """The settings; those of the camera for a viewer."""

    @property
    def writes(self) -> bool:
        """Whether it writes a file: such a task is queued instead of refused."""
        return self.check in ("keep", "keep depth")


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
    if asked.check == "viewer":
        return _viewer(asked)
    if asked.check == "keep":
        from lfpipe.config.user_files import write_keys

        try:
            write_keys(Path(asked.path), asked.section, asked.values)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise UserError(f"{asked.path}: not saved: {why}", FIX_SETTINGS) from None
        return {}
    if asked.check == "keep depth":
        from lfpipe.scene.inverted_depth import remember
        from lfpipe.scene.pack import open_pack

        remember(open_pack(Path(asked.path)), asked.values["depth"])
        return {}
    plugin = guarded(load(REQUESTS, asked.check, ()), REQUESTS, asked.check, {"check": dict})
    return dict(plugin.check(asked))


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
