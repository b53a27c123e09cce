"""What the child of `file_checks` writes, one request after the other."""

import select
from contextlib import closing
from pathlib import Path
from unittest.mock import patch

import attrs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfpipe.errors import UserError
from lfpipe.scene.demo import demo_scene
from lfpipe.scene.recent_scenes import remember_scene
from lfpipe.supervisor.check_service import CheckEvent, FileChecks
from lfpipe.supervisor.control_sockets import Request
from lfpipe.supervisor.file_checks import START, FileCheck, check
from lfpipe.transport import control
from lfpipe.transport.control import Message


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
            asked = FileCheck(check="keep", path=str(path), section="render", values=values)
            checks.begin(Request(b"render", message={"cmd": "keep"}), asked)
        assert [event.result for event in finish(checks, 2)] == [{}, {}]
    assert path.read_text() == (
        "# mine\n[render]\nmethod = 'warp'\nswap_eyes = true\nanaglyph = \"mono\"\n"
    )


def test_keep_reports_a_file_that_it_cannot_change(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text("[render")
    with closing(FileChecks(set)) as checks:
        asked = FileCheck(check="keep", path=str(path), section="render", values={"depth": 1.0})
        checks.begin(Request(b"render", message={"cmd": "keep"}), asked)
        (event,) = finish(checks, 1)
    assert isinstance(event.result, UserError)
    assert f"{path}: depth not saved" in event.result.message and event.result.remedy
    assert path.read_text() == "[render"


def listed(path: str) -> Message:
    """What the child lists in a folder."""
    return check(attrs.asdict(FileCheck(check="folder", path=path)), print)


def test_folder_lists_what_there_is_to_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("b10", "b9", ".hidden"):
        (tmp_path / name).mkdir()
    for name in ("view_10.png", "view_2.PNG", "film.mp4", "field.h5", "notes.txt", ".thumb.png"):
        (tmp_path / name).touch()
    found = {
        "path": str(tmp_path),
        "folders": ["b9", "b10"],
        "files": ["field.h5", "film.mp4", "view_2.PNG", "view_10.png"],
        "more": 0,
    }
    assert listed(str(tmp_path)) == found
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / ".state"))
    monkeypatch.setenv("HOME", str(tmp_path / "b9"))
    assert listed(START)["path"] == str(tmp_path / "b9"), "at home"
    remember_scene(tmp_path / "film.mp4")
    remember_scene(demo_scene(tmp_path / "b10"))
    assert listed(START) == found, "where the last scene is that is no demo"
    with pytest.raises(UserError, match="gone: cannot be read: No such file"):
        listed(str(tmp_path / "gone"))


@settings(max_examples=10)
@given(st.integers(0, 3000), st.integers(0, 3000), st.integers(1, 200))
def test_folder_of_many_names_fits_into_a_message(folders: int, files: int, size: int) -> None:
    counts = (files, ".png"), (folders, "")
    names = [[f"{n:0{size}}{end}" for n in range(count)] for count, end in counts]
    with patch("lfpipe.scene.files.entries", lambda _: names):
        found = listed("/f")
    assert len(control.encode({"cmd": "folder", "ok": True, "rev": 1 << 60, **found}))
    shown = len(found["folders"]), len(found["files"])
    assert sum(shown) + found["more"] == folders + files
    assert shown[0] == folders or not shown[1]
    assert not found["more"] or sum(shown) * (size + 9) > 40_000, "as many as there is room for"
