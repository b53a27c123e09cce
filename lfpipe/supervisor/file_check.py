"""A child process that checks paths and hosts for the supervisor, because a dead network drive or name server blocks who asks it.

`python -m lfpipe.supervisor.file_check`. Request: {"check": "trace", "record" or "share", ...}, by `requests`.
"""

from pathlib import Path
from typing import Any

from lfpipe.host.worker import Report, serve

MEMORY_BYTES = 1 << 30  # the libraries of a recording reserve 300 MB when they are imported


def check(request: dict[str, Any], _report: Report) -> dict[str, Any]:
    """The result of one check. Raises UserError."""
    if request["check"] == "trace":
        from lfpipe.capture.spec import source_file
        from lfpipe.files.output import check_output

        inputs = (source_file(request["source"]), Path(request["record"]) if request["record"] else None)
        check_output(Path(request["path"]), [source for source in inputs if source is not None])
        return {}
    if request["check"] == "record":
        from lfpipe.sequence.folder import check_out

        check_out(Path(request["path"]))
        return {}
    from lfpipe.share.target import check_targets

    return {"targets": list(check_targets(request["targets"], request["running"]))}


if __name__ == "__main__":
    serve(check, MEMORY_BYTES)
