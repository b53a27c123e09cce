"""Every example of README and docs/ works: code runs, files are accepted; recipes run on a
session's data. Commands: test_commands.py.
"""

import importlib
import json
import os
import re
import runpy
import shutil
import signal
import textwrap
import time
import tomllib
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.frame_source import FrameSource
from lfpipe.capture.open_source import camera_name, check_source, clock_of, open_source
from lfpipe.capture.spec import KINDS
from lfpipe.config.modes import Live
from lfpipe.errors import UserError
from lfpipe.eyes import EYES
from lfpipe.scene import layouts
from lfpipe.transport import ring
from tests.docs.conftest import PAGES, ROOT, blocks
from tests.support.world import World, until


def test_docs_blocks_of_data_are_well_formed() -> None:
    for page in PAGES:
        for block in blocks(page, "toml"):
            tomllib.loads(block)
        for block in blocks(page, "json"):
            json.loads(block)


@pytest.mark.nightly
def test_ring_example_reads_a_frame(
    live: World, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    example = next(block for block in blocks("docs/contracts.md") if "open_ring" in block)
    path = live.root / "ring_example.py"
    path.write_text(example.replace('"default"', f'"{live.name}"'))
    monkeypatch.setenv("LFPIPE_RUN_DIR", str(live.run_dir))
    runpy.run_path(str(path))
    seq, t_sensor_ns, _skipped, mean = capsys.readouterr().out.split()
    assert (
        int(seq) > 0
        and time.monotonic_ns() - int(t_sensor_ns) < 10_000_000_000
        and 0 < float(mean) < 255
    )


def test_contracts_say_where_the_parts_of_a_ring_are(tmp_path: Path) -> None:
    """The offsets of the page, against a ring that the code made."""
    page = (ROOT / "docs" / "contracts.md").read_text()
    table = page.partition("| at byte ")[2].partition("\n\n")[0]
    rows = [line.split("|")[1:3] for line in table.splitlines()[2:]]
    offsets = [[int(n) for n in re.findall(r"\d+", left)] for left, _ in rows]
    assert offsets == [
        [8, 16, 24, 32],
        [ring.PUBLISHED, ring.EPOCH],
        [ring.DESCRIPTION],
        [0],
        [8, 16, 24, 32],
        [40, 48, ring.SLOT_HEADER],
    ]
    path = tmp_path / "eyes.ring"
    memory = ring.create(path, ring.RingSpec((), EYES))
    try:
        writer, reader = ring.Writer(path), ring.Reader(path)
        writer.begin()
        writer.publish(7, 8, 9, epoch=3, kind=2)
        raw = bytes(memory.buf)
        first = ring.PAGE
        assert np.frombuffer(raw, "<i8", 4, 8).tolist()[:3] == [4, ring.PAGE, EYES.itemsize]
        assert np.frombuffer(raw, "<i8", 5, first).tolist() == [1, 7, 3, 8, 9]
        assert np.frombuffer(raw, "<i8", 1, first + 48)[0] == 2
        writer.close()
        reader.close()
    finally:
        memory.unlink()
        memory.close()


def test_layout_example_opens_its_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(ROOT / "examples/lfpipe-example/lfpipe_example/trio.py", tmp_path)
    monkeypatch.setattr(layouts, "__path__", [*layouts.__path__, str(tmp_path)])
    importlib.invalidate_caches()
    scene = tmp_path / "scene"
    scene.mkdir()
    for value, name in enumerate(("left", "middle", "right")):
        cv2.imwrite(str(scene / f"{name}.png"), np.full((8, 8, 3), 10 * value, np.uint8))
    found = layouts.describe(scene, config.Scene())
    assert (found.layout, found.rows, found.cols) == ("trio", 1, 3)


RUNNER = """
    from lfpipe.supervisor import process_table
    from lfpipe.supervisor.process_table import Stage

    if __name__ == "__main__":
        process_table.STAGES = (*process_table.STAGES, {row})
        process_table.NAMES = tuple(stage.name for stage in process_table.STAGES)
        process_table.METRICS = {{one.name: one.metrics for one in process_table.STAGES}}
        from lfpipe.cli import run

        run()
"""


@pytest.mark.nightly
def test_stage_example_runs_in_a_session(world: World, scene: Path, tmp_path: Path) -> None:
    page = (ROOT / "docs" / "extending.md").read_text()
    row = re.search(r"`(Stage\(.*?\))`\.", page, re.S)
    assert row is not None
    example = next(block for block in blocks("docs/extending.md") if "def main" in block)
    (tmp_path / "away.py").write_text(example)
    (tmp_path / "runner.py").write_text(
        textwrap.dedent(RUNNER).format(row=row[1].replace("lfpipe.track.away", "away"))
    )
    world.module = "runner"
    world.env["PYTHONPATH"] = os.pathsep.join([str(tmp_path), str(ROOT)])
    process = world.shows(scene, pictures=1)
    world.wait_for(lambda: world.monitor()["stages"]["away"]["count"] > 5, "outputs of the stage")
    assert "failed" not in world.ended(process, signal.SIGTERM)


def test_source_example_delivers_frames_and_hides_its_password(
    monkeypatch: pytest.MonkeyPatch, clip: Path
) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples" / "lfpipe-example")
    rtsp = importlib.import_module("lfpipe_example.rtsp")
    monkeypatch.setitem(KINDS, "rtsp", rtsp.RtspSource)
    camera = config.Camera()
    url = "rtsp://me:secret@camera.example/stream"
    with pytest.raises(UserError, match=r"rtsp://\*\*\*@camera.example/stream: cannot") as refused:
        monkeypatch.setattr(cv2, "VideoCapture", lambda _: SimpleNamespace(isOpened=bool))
        check_source(url, camera)
    assert "secret" not in str(refused.value) + camera_name(url)
    monkeypatch.undo()
    monkeypatch.setitem(KINDS, "rtsp", rtsp.RtspSource)
    capture = cv2.VideoCapture
    monkeypatch.setattr(cv2, "VideoCapture", lambda _: capture(str(clip)))
    viewer = check_source(url, camera)
    assert viewer.source == url and clock_of(url) == Live()
    source = open_source(url, camera, reconnect=True)
    out = np.zeros((480, 640, 3), np.uint8)
    until(lambda: frame_of(source, out) is not None, "a frame")
    assert out.any() and "secret" not in source.info.name
    source.close()


def frame_of(source: FrameSource, out: np.ndarray) -> object:
    try:
        return source.read(out)
    except TimeoutError:
        return None


def test_window_projection_example_keeps_the_screen_in_place() -> None:
    made = runpy.run_path(str(ROOT / "examples" / "window_projection.py"))["window_projection"]
    for eye in ((0, 0, 600), (120, -80, 450), (-200, 60, 900)):
        projection, view = made(eye, (530, 300))
        for corner in ((-265, -150), (265, -150), (-265, 150)):
            seen = projection @ view @ (*corner, 0, 1)
            np.testing.assert_allclose(seen[:2] / seen[3], np.sign(corner), atol=1e-9)
        behind = projection @ view @ (*eye[:2], -300, 1)  # straight ahead of the eye
        at_screen = projection @ view @ (*eye[:2], 0, 1)
        np.testing.assert_allclose(behind[:2] / behind[3], at_screen[:2] / at_screen[3], atol=1e-9)
