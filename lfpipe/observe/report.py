"""The report for a bug: one ZIP with versions, settings, checks, and the log and state of the user's sessions."""

import contextlib
import json
import platform
import zipfile
from collections.abc import Iterable
from pathlib import Path

from lfpipe import config, log
from lfpipe.config.user_files import commented
from lfpipe.errors import UserError
from lfpipe.files.safe_files import reason
from lfpipe.host.machine import versions
from lfpipe.observe.doctor import Check
from lfpipe.supervisor import rundir
from lfpipe.transport.session import Session

SECRETS = ("kiosk",)  # options of a session that nobody else should know


def _contents(checks: Iterable[Check]) -> dict[str, str | bytes]:
    """Name in the ZIP -> content."""
    found: dict[str, str | bytes] = {
        "versions.json": json.dumps({**versions(), "system": platform.platform()}, indent=1),
        "doctor.txt": "\n".join(f"{'' if each.ok else 'FAIL '}{each.name}: {each.detail}; {each.remedy}" for each in checks),
    }
    try:
        found["config.toml"] = commented(config.load())
    except UserError as error:
        found["config.txt"] = str(error)
    with contextlib.suppress(OSError):
        found[log.last_file().name] = log.last_file().read_bytes()
    for name in rundir.running():
        run_dir = Session(name).run_dir
        with contextlib.suppress(OSError, ValueError):  # it has just ended
            about = json.loads((run_dir / "session.json").read_text())
            about["options"] = {key: value for key, value in about["options"].items() if key not in SECRETS}
            found[f"{name}/session.json"] = json.dumps(about, indent=1)
            found[f"{name}/{log.FILE}"] = log.lines(run_dir)
            for path in sorted(run_dir.glob("stack.*")):
                found[f"{name}/{path.name}"] = path.read_bytes()
    return found


def write_report(path: Path, checks: Iterable[Check]) -> None:
    """Writes a new ZIP file. Raises UserError, also if path exists."""
    contents = _contents(checks)
    try:
        with path.open("xb") as file, zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as report:
            for name, content in contents.items():
                report.writestr(name, content)
    except OSError as error:
        raise UserError(f"--report {path}: {reason(error)}", "name a new file in a folder that you may write to") from None
