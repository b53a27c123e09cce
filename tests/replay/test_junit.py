"""JUnit says failure or error whenever the exit code is not 0, whichever way a replay ends."""

import signal
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from lfpipe import cli
from lfpipe.errors import UserError
from lfpipe.replays import run
from lfpipe.replays.compare import Difference, cases_of
from lfpipe.replays.run import write_junit
from tests.support import hostile_sequences
from tests.support.world import World

REFERENCE = Path(__file__).parent / "reference"


@pytest.fixture(scope="module")
def seq(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hostile_sequences.made_sequence(tmp_path_factory.mktemp("sequences") / "seq")


def outcome(path: Path) -> tuple[int, int, str]:
    """(failures, errors, all that is said) of a JUnit file, whose counts agree with its
    contents.
    """
    suite = ElementTree.parse(path).getroot()
    failures, errors = suite.findall("testcase/failure"), suite.findall("testcase/error")
    assert int(suite.attrib["failures"]) == len(failures) and int(suite.attrib["errors"]) == len(
        errors
    )
    assert int(suite.attrib["tests"]) == len(suite.findall("testcase"))
    return (
        len(failures),
        len(errors),
        "\n".join(each.attrib["message"] for each in failures + errors),
    )


def typed(monkeypatch: pytest.MonkeyPatch, *args: str | Path) -> int:
    """The exit code of `lfpipe replay` with these arguments."""
    monkeypatch.setattr(sys, "argv", ["lfpipe", "replay", *map(str, args)])
    with pytest.raises(SystemExit) as ended:
        cli.run()
    return int(ended.value.code or 0)


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("nowhere",), "nowhere"),
        (("SEQ", "--set", "render.methd=warp"), "render.method"),
        (("SEQ", "--update"), "--expect"),
        (("SEQ", "--expect", "REFERENCE"), "another sequence"),
        (("SEQ", "--out", "/proc/none"), "/proc/none"),
    ],
)
def test_bad_input_is_an_error(
    seq: Path,
    blocks: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    args: tuple[str, ...],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "home"))
    places = {"SEQ": str(seq), "REFERENCE": str(REFERENCE)}
    scene = () if "--scene" in args else ("--scene", str(blocks))
    junit = ("--junit", "j.xml", "--overwrite")
    write_junit(tmp_path / "j.xml", "seq", [], "", 1.0)  # of a run that passed
    assert typed(monkeypatch, *junit, *scene, *(places.get(arg, arg) for arg in args)) == 2
    failures, errors, text = outcome(tmp_path / "j.xml")
    assert (failures, errors) == (0, 1) and said in text


def test_differences_are_failures_of_their_own(tmp_path: Path) -> None:
    differences = [
        Difference("eyes", "moved\x07", 3),
        Difference("eyes", "again", 4),
        Difference("plan", "x" * 10**6),
    ]
    write_junit(tmp_path / "j.xml", "a\x00\udcff<", cases_of(differences), "", 1.5)
    failures, errors, text = outcome(tmp_path / "j.xml")
    assert (failures, errors) == (2, 0) and "frame 3: moved" in text
    assert (tmp_path / "j.xml").stat().st_size < 50_000
    write_junit(tmp_path / "j.xml", "walk", cases_of([]), "", 1.5)
    assert outcome(tmp_path / "j.xml")[:2] == (0, 0)


def test_an_interrupted_replay_reports_it(world: World, short: Path, blocks: Path) -> None:
    junit = world.root / "j.xml"
    process = world.start(
        "replay",
        short,
        "--scene",
        blocks,
        "--pace",
        "0.5",
        "--junit",
        junit,
        "--out",
        world.root / "out",
    )
    trace = world.root / "out" / "trace.jsonl"
    world.wait_for(lambda: trace.exists() and trace.stat().st_size, "picture")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130 and outcome(junit)[:2] == (0, 1)


@pytest.mark.parametrize(
    ("failure", "code", "said"),
    [
        (run.ReplayFailed("render failed on the way"), 1, "render failed on the way"),
        (UserError("no memory for rings", "close something"), 2, "no memory for rings"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (RuntimeError("a fault \x00\x1b[2J of \ud800 ours"), None, "a fault"),
        (MemoryError(), 2, "MemoryError"),
    ],
)
def test_a_failure_on_the_way_is_an_error(
    seq: Path,
    blocks: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    failure: BaseException,
    code: int | None,
    said: str,
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocks.parent / "cache"))  # packed once

    def fail(*_: Any) -> None:
        assert outcome(tmp_path / "j.xml") == (
            0,
            1,
            "it did not finish",
        ), "what the file holds if we are killed now"
        raise failure

    monkeypatch.setattr(run, "replay", fail)
    args = (seq, "--scene", blocks, "--junit", tmp_path / "j.xml", "--out", tmp_path / "out")
    if code is None:
        with pytest.raises(type(failure)):
            typed(monkeypatch, *args)
    else:
        assert typed(monkeypatch, *args) == code
    assert outcome(tmp_path / "j.xml")[:2] == (0, 1) and said in outcome(tmp_path / "j.xml")[2]
