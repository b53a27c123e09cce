"""The log: what is written where, and its report."""

import json
import logging
import multiprocessing
import os
import zipfile
from pathlib import Path

import pytest

from lfpipe import log
from lfpipe.errors import UserError
from tests.world import World


@pytest.fixture(autouse=True)
def _as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(log.VARIABLE, "")
    root = logging.getLogger("lfpipe")
    monkeypatch.setattr(root, "handlers", list(root.handlers))
    monkeypatch.setattr(root, "level", logging.NOTSET)


def test_the_terminal_is_silent_unless_asked(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    logger = logging.getLogger("lfpipe.some.room")
    log.set_up()
    logger.info("decided")
    assert capfd.readouterr() == ("", "") and log.VARIABLE in os.environ
    log.set_up(1)
    logger.info("decided %d", 2)
    logger.debug("detail")
    assert capfd.readouterr().err.endswith("INFO MainProcess lfpipe.some.room: decided 2\n")
    monkeypatch.setenv(log.VARIABLE, "loud")
    with pytest.raises(UserError, match="loud"):
        log.set_up()


def _write(path: Path, word: str, count: int) -> None:
    handler = log.SessionFile(path)
    for number in range(count):
        handler.emit(
            logging.LogRecord(
                "lfpipe", logging.INFO, "", 0, "%s %d %s", (word, number, "x" * 400), None
            )
        )


def test_the_file_of_several_processes_is_bounded_and_loses_no_line(tmp_path: Path) -> None:
    path, count = tmp_path / log.FILE, 1000
    writers = [
        multiprocessing.get_context("fork").Process(target=_write, args=(path, word, count))
        for word in "abc"
    ]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    sizes = [entry.stat().st_size for entry in tmp_path.iterdir()]
    assert len(sizes) == 2 and max(sizes) < 2 * log.MAX_BYTES, (
        "others may write until the process that fills it has renamed it"
    )
    lines = log.lines(tmp_path).decode().splitlines()
    assert all(line.endswith("x" * 400) for line in lines)
    assert len(lines) == 3 * count, "the second file is not full: no line was dropped"


def test_the_report_of_a_session_has_its_log_and_no_code(live: World, tmp_path: Path) -> None:
    """The log tells of every stage, from its own process; a report of the running session holds it."""
    done = live.run("doctor", "--report", tmp_path / "report.zip")
    assert done.returncode in (0, 1), done.stderr
    with zipfile.ZipFile(tmp_path / "report.zip") as report:
        names = report.namelist()
        assert {"versions.json", "doctor.txt", "config.toml"} <= set(names)
        text = report.read(f"{live.name}/{log.FILE}").decode()
        about = json.loads(report.read(f"{live.name}/session.json"))
    assert "kiosk" not in about["options"] and about["session"] == live.name
    for stage in ("capture", "track", "render"):
        assert f" INFO lfpipe-{stage} lfpipe.transport.context: ready after" in text
        assert f": {stage} starts as process" in text
    again = live.run("doctor", "--report", tmp_path / "report.zip")
    assert again.returncode == 2 and "report.zip" in again.stderr
