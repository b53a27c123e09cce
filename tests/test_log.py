"""The log: its content, its destinations and its report."""

import json
import logging
import multiprocessing
import os
import zipfile
from pathlib import Path

import pytest

from lfpipe import log
from tests.support.refusal import refusal
from tests.support.world import World


def test_log_is_silent_on_the_terminal_unless_asked(
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
    assert "loud" in str(refusal(log.set_up))


def test_log_escapes_what_a_record_quotes(
    capfd: pytest.CaptureFixture[str],
) -> None:
    log.set_up(1)
    logging.getLogger("lfpipe.some.room").info("opens %s", "/tmp/\x1b[2J\x07")
    assert "\\x1b[2J\\x07" in (said := capfd.readouterr().err) and "\x1b" not in said


def _write(path: Path, word: str, count: int) -> None:
    handler = log.SessionFile(path)
    for number in range(count):
        handler.emit(
            logging.LogRecord(
                "lfpipe", logging.INFO, "", 0, "%s %d %s", (word, number, "x" * 400), None
            )
        )


def test_log_session_file_is_bounded_and_loses_no_line(tmp_path: Path) -> None:
    path = tmp_path / log.FILE
    count = 1000
    writers = [
        multiprocessing.get_context("fork").Process(target=_write, args=(path, word, count))
        for word in "abc"
    ]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(60)
    sizes = [entry.stat().st_size for entry in tmp_path.iterdir()]
    assert len(sizes) == 2 and max(sizes) < 2 * log.MAX_BYTES, (
        "others may write until the process that fills it has renamed it"
    )
    lines = log.lines(tmp_path).decode().splitlines()
    assert all(line.endswith("x" * 400) for line in lines)
    assert len(lines) == 3 * count, "the second file is not full: no line was dropped"


def test_log_of_a_session_is_in_its_report(live: World, tmp_path: Path) -> None:
    """The log tells of every stage, from its own process; a report of the running session
    holds it.
    """
    done = live.run("doctor", "--report", tmp_path / "report.zip")
    assert done.returncode in (0, 1), done.stderr
    with zipfile.ZipFile(tmp_path / "report.zip") as report:
        names = report.namelist()
        assert {"versions.json", "doctor.txt", "config.toml"} <= set(names)
        text = report.read(f"{live.name}/{log.FILE}").decode()
        about = json.loads(report.read(f"{live.name}/session.json"))
    assert "lock_code" not in about["options"]["display"] and about["session"] == live.name
    for stage in ("capture", "track", "render"):
        assert f" INFO lfpipe-{stage} lfpipe.transport.context: ready after" in text
        assert f": {stage} starts as process" in text
