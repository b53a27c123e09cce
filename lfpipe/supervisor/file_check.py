"""A child process that checks files and hosts for the supervisor. Whatever happens to it, the session continues.

Run as `python -m lfpipe.supervisor.file_check` with the request as JSON in the argument. Prints a line of words for each
step, then one line of JSON, {"ok": true, "result": {...}} or {"ok": false, "error": ..., "remedy": ...}. Ends with its standard
input, when the supervisor is gone.
"""

import contextlib
import json
import os
import sys
import threading
from pathlib import Path
from typing import Any

import attrs

from lfpipe import config as config_module
from lfpipe.errors import UserError
from lfpipe.host.limits import limit_memory

MEMORY_BYTES = 3 << 30  # for packing; mapped files do not count


def check(request: dict[str, Any]) -> dict[str, Any]:
    """The result of one check; for a "scene" its summary, after packing if necessary. Raises UserError."""
    path = Path(request["path"])
    if request["check"] == "trace":
        from lfpipe.capture.spec import source_file
        from lfpipe.files.output import check_output

        inputs = (source_file(request["source"]), Path(request["record"]) if request["record"] else None)
        check_output(path, [source for source in inputs if source is not None])
        return {}
    if request["check"] == "record":
        from lfpipe.sequence.folder import check_out

        check_out(path)
        return {}
    if request["check"] == "share":
        from lfpipe.share.target import check_targets

        return {"targets": list(check_targets(request["targets"], request["running"]))}
    from lfpipe.render.scoring import choose_method
    from lfpipe.scene.cache import cache_dir
    from lfpipe.scene.pack import open_scene
    from lfpipe.scene.recent_scenes import remember_scene
    from lfpipe.scene.summary import summarize

    how = {key: request[key] for key in ("layout", "grid") if key in request}
    settings = attrs.evolve(config_module.trusted(request["config"]).scene, **how)
    found = attrs.asdict(summarize(open_scene(path, settings, _step, choose_method), settings))
    if not path.is_relative_to(cache_dir(settings)):  # the demo is always there
        remember_scene(path)
    return found


def _step(what: str, done: int, total: int) -> None:
    print(f"{what} {done} of {total}", flush=True)


def _end_with_parent() -> None:
    with contextlib.suppress(OSError):
        while os.read(0, 4096):
            pass
    os._exit(1)


def main(text: str) -> int:
    """Checks and prints the answer."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    limit_memory(MEMORY_BYTES)
    try:
        answer = {"ok": True, "result": check(json.loads(text))}
    except UserError as error:
        answer = {"ok": False, "error": error.message, "remedy": error.remedy}
    except MemoryError:
        answer = {"ok": False, "error": f"opening it needs more than {MEMORY_BYTES >> 30} GiB", "remedy": "use a smaller scene"}
    print(json.dumps(answer), flush=True)
    return 0


if __name__ == "__main__":
    code = main(sys.argv[1])
    sys.stdout.flush()
    os._exit(code)  # the thread still blocks in read
