"""What the child of `file_checks` writes, one request after the other."""

import select
from contextlib import closing
from pathlib import Path

from lfpipe.errors import UserError
from lfpipe.supervisor.check_service import CheckEvent, FileChecks
from lfpipe.supervisor.control_sockets import Request
from lfpipe.supervisor.file_checks import FileCheck


def finish(checks: FileChecks, count: int) -> list[CheckEvent]:
    """The events of so many checks, whose client has left meanwhile."""
    events: list[CheckEvent] = []
    while len(events) < count:
        select.select(checks.fds, [], [], 0.05)
        events += checks.events()
    return events


def test_keep_writes_settings_one_after_the_other(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text("# mine\n[render]\nmethod = 'warp'\n")
    with closing(FileChecks(set)) as checks:
        for values in ({"swap_eyes": True}, {"anaglyph": "mono"}):
            check = FileCheck(check="keep", path=str(path), section="render", values=values)
            checks.begin(Request(b"render", message={"cmd": "keep"}), check)
        assert [event.result for event in finish(checks, 2)] == [{}, {}]
    assert path.read_text() == (
        "# mine\n[render]\nmethod = 'warp'\nswap_eyes = true\nanaglyph = \"mono\"\n"
    )


def test_keep_reports_a_file_that_it_cannot_change(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text("[render")
    with closing(FileChecks(set)) as checks:
        check = FileCheck(check="keep", path=str(path), section="render", values={"depth": 1.0})
        checks.begin(Request(b"render", message={"cmd": "keep"}), check)
        (event,) = finish(checks, 1)
    assert isinstance(event.result, UserError)
    assert f"{path}: not saved" in event.result.message and event.result.remedy
    assert path.read_text() == "[render"
