"""The desktop's file dialog, with a script in place of zenity."""

import os
import select
from contextlib import closing
from pathlib import Path

import pytest

from lfpipe.supervisor.control_sockets import Request
from lfpipe.supervisor.file_dialog import FileDialog
from tests.support.refusal import refusal

REQUEST = Request(b"render", connection=7, message={"cmd": "dialog"})


@pytest.fixture
def zenity(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A program in place of zenity: write its lines of shell there."""
    program = tmp_path / "zenity"
    program.touch(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    return program


CONNECTIONS = {7}


def chosen(dialog: FileDialog) -> tuple[Request, str] | None:
    """What comes of a dialog that ends."""
    while dialog.fds:
        select.select(dialog.fds, [], [], 60)
        if answer := dialog.chosen():
            return answer
    return None


@pytest.mark.parametrize(
    ("script", "path"),
    [
        ("echo /a/scene with spaces", "/a/scene with spaces"),
        ("printf '/a/\\377\\n'", "/a/\udcff"),
        ("exit 1", ""),
        ("echo", ""),
    ],
)
def test_dialog_returns_the_chosen_path(zenity: Path, script: str, path: str) -> None:
    zenity.write_text(f"#!/bin/sh\n{script}\n")
    with closing(FileDialog(CONNECTIONS.copy)) as dialog:
        dialog.open(REQUEST, folder=True)
        assert chosen(dialog) == (REQUEST, path)
        assert dialog.chosen() is None and not dialog.fds


def test_dialog_asks_for_a_folder_or_a_file(zenity: Path) -> None:
    zenity.write_text('#!/bin/sh\necho "/$*"\n')
    with closing(FileDialog(CONNECTIONS.copy)) as dialog:
        for folder in (True, False):
            dialog.open(REQUEST, folder)
            answer = chosen(dialog)
            assert answer is not None and ("--directory" in answer[1]) is folder


def test_dialog_is_the_only_one_and_ends_with_its_client(zenity: Path) -> None:
    zenity.write_text("#!/bin/sh\nexec sleep 600\n")
    open_now = {7}
    with closing(FileDialog(open_now.copy)) as dialog:
        dialog.open(REQUEST, folder=False)
        assert "already open" in refusal(dialog.open, REQUEST, True).message
        assert dialog.chosen() is None and dialog.fds
        open_now.clear()
        assert dialog.chosen() is None and not dialog.fds


def test_dialog_needs_a_program(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    refused = refusal(FileDialog(CONNECTIONS.copy).open, REQUEST, True)
    assert "zenity" in refused.remedy and "no file dialog" in refused.message
