"""The log: its content, its destinations and its report."""

import logging
import multiprocessing
import os
from pathlib import Path

import pytest

from lfpipe import log
from tests.support.refusal import refusal


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


def _write(path: Path, name: str, count: int) -> None:
    multiprocessing.current_process().name = name
    log.set_up()
    with log.kept_in(path):
        for number in range(count):
            logging.getLogger("lfpipe").info("%s %d %s", name, number, "x" * 400)


def test_log_of_several_processes_is_bounded_and_in_order(tmp_path: Path) -> None:
    count = 3000
    writers = [
        multiprocessing.get_context("fork").Process(target=_write, args=(tmp_path, name, count))
        for name in "abc"
    ]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(60)
    sizes = [entry.stat().st_size for entry in tmp_path.iterdir()]
    assert len(sizes) == 6 and max(sizes) <= log.MAX_BYTES
    lines = log.lines(tmp_path).decode().splitlines()
    assert all(line.endswith("x" * 400) for line in lines)
    assert lines == sorted(lines, key=lambda line: line[: log.TIME_BYTES])
    for name in "abc":
        numbers = [int(line.split()[6]) for line in lines if f" lfpipe: {name} " in line]
        assert numbers == list(range(numbers[0], count)), "no line of the newest is missing"
