"""A program that draws a live scene, its ring, and the names of live scenes."""

import os
from pathlib import Path

import numpy as np
import pytest

import lfpipe
from lfpipe.capture.frame_source import Frame, SourceInfo
from lfpipe.capture.open_source import RingSource, RowSource, check_live
from lfpipe.capture.spec import is_live
from lfpipe.cli.prepare import Request, _open_live
from lfpipe.cli.sessions import UpArguments
from lfpipe.config import Config
from lfpipe.config.session_options import MouseViewer, Window
from lfpipe.errors import UserError
from lfpipe.live.records import VIEWPOINTS, Program, cut, scene_of
from lfpipe.transport import ring
from lfpipe.transport.ring import Stamp
from tests.live.made import maps_of
from tests.support.films import write_film

SHAPE = (2, 3, 48, 64, 3)
NAME = f"test_{os.getpid()}"


def stamp_of(frame: Frame) -> Stamp:
    return Stamp(1, frame.source_seq, 0, frame.t_sensor_ns, frame.t_read_ns, 0, 0)


def test_live_scene_reaches_a_session_with_its_disparity_and_learns_its_viewpoints() -> None:
    views = np.random.default_rng(1).integers(0, 256, SHAPE, np.uint8)
    disparity = np.full((2, 3, 24, 32), 1.5)
    with lfpipe.LiveScene(NAME, rows=2, cols=3, size_px=(64, 48)) as scene:
        live = check_live(f"live:ring:{NAME}", Config())
        assert (live.rows, live.cols, live.width_px, live.height_px) == (2, 3, 64, 48)
        source, program = RingSource(NAME), Program(live)
        scene.write(views, disparity, t_ns=123)
        out = np.empty((96, 192, 3), np.uint8)
        frame = source.read(out)
        assert frame is not None and frame.t_sensor_ns == 123
        for row, col in np.ndindex(2, 3):
            np.testing.assert_array_equal(cut(out, live, (row, col)), views[row, col])
        found = program.disparity(stamp_of(frame), [(1, 2)])
        assert found is not None
        np.testing.assert_allclose(maps_of(found)[1, 2], 1.5, atol=0.05)
        scene.write(views)
        frame = source.read(out)
        assert frame is not None and program.disparity(stamp_of(frame), [(1, 2)]) is None
        assert scene.wanted() is None
        at = np.zeros((), VIEWPOINTS)
        at["left"], at["right_mm"] = (0.5, 1.25), (30.0, -4.0, 600.0)
        program.send_viewpoints(at)
        wanted = scene.wanted()
        assert wanted is not None
        assert wanted.left == (0.5, 1.25) and wanted.right_mm == (30.0, -4.0, 600.0)
        source.close()
        program.close()
    with pytest.raises(UserError, match="no such live scene"):
        RingSource(NAME)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("step_px", np.nan),
        ("step_px", np.inf),
        ("step_px", -1.0),
        ("step_px", 1e9),
        ("positions", np.inf),
        ("positions", -1e300),
    ],
)
def test_disparity_that_no_program_means_is_measured_instead(name: str, value: float) -> None:
    with lfpipe.LiveScene(NAME, rows=1, cols=2, size_px=(64, 48)):
        program = Program(check_live(f"live:ring:{NAME}", Config()))
        writer = ring.Writer(scene_of(NAME))  # in another language, which checks nothing
        for wrong in (False, True):
            record = writer.begin()
            record["step_px"], record["positions"] = 0.5, np.nan
            record["maps"] = 3
            if wrong:
                record[name] = value
            del record
            writer.publish(1, 77 + wrong, 77)
            found = program.disparity(stamp_of(Frame(1, 77 + wrong, 77)), [(0, 0)])
            assert (found is None) == wrong
        writer.close()
        program.close()


def test_program_that_comes_back_with_other_views_is_not_read() -> None:
    with lfpipe.LiveScene(NAME, rows=1, cols=2, size_px=(64, 48)):
        live = check_live(f"live:ring:{NAME}", Config())
    disparity = np.zeros((1, 2, 30, 40))
    with lfpipe.LiveScene(NAME, rows=1, cols=2, size_px=(80, 60)) as scene:
        program = Program(live)
        scene.write(np.zeros((1, 2, 60, 80, 3), np.uint8), disparity, t_ns=7)
        assert program.disparity(stamp_of(Frame(1, 7, 7)), [(0, 0)]) is None


def test_mouse_looks_around_a_scene_that_is_captured_now() -> None:
    with lfpipe.LiveScene(NAME, rows=1, cols=2, size_px=(64, 48)):
        arguments = UpArguments(scenes=(Path(f"live:ring:{NAME}"),))
        request = Request(config=Config(), display=Window(), source="mouse", duration_s=None)
        assert _open_live(arguments, request).options.viewer == MouseViewer()


def test_live_scene_names_a_value_and_its_remedy() -> None:
    with lfpipe.LiveScene(NAME, rows=1, cols=2, size_px=(64, 48)) as scene:
        views = np.zeros((1, 2, 48, 64, 3), np.uint8)
        for wrong, disparity, named in (
            (views[:, :1], None, r"\(1, 1, 48"),
            (views.astype(float), None, "float64"),
            (views, np.zeros((1, 2, 48, 64)), r"\(1, 2, 48, 64\)"),
            (views, np.full((1, 2, 24, 32), np.nan), "no numbers"),
        ):
            with pytest.raises(UserError, match=named):
                scene.write(wrong, disparity)
        with pytest.raises(UserError, match="in use"):
            lfpipe.LiveScene(NAME, rows=1, cols=2, size_px=(64, 48))
    for name, rows, cols, size_px in (
        ("a/b", 1, 2, (64, 48)),
        ("a", 0, 2, (64, 48)),
        ("a", 1, 1, (64, 48)),
        ("a", 1, 2, (64, 1 << 20)),
    ):
        with pytest.raises(UserError):
            lfpipe.LiveScene(name, rows=rows, cols=cols, size_px=size_px)
    assert not [path for path in Path("/dev/shm").iterdir() if NAME in path.name]


@pytest.mark.parametrize(
    ("size_px", "query", "wanted"),
    [
        ((320, 120), "", (1, 2, 160, 120)),
        ((160, 120), "?layout=side-by-side", (1, 2, 80, 120)),
        ((160, 120), "?layout=over-under", (1, 2, 160, 60)),
        ((192, 144), "?grid=3x3", (3, 3, 64, 48)),
        ((192, 144), "?layout=mosaic&grid=3x2", (3, 2, 96, 48)),
        ((160, 120), "", "layout=side-by-side"),
        ((160, 120), "?layout=sideways", "layout=sideways"),
        ((160, 120), "?grid=3x", "grid=3x"),
        ((160, 120), "?grid=7x7", "is not 7x7 views"),
        ((160, 120), "?grid=8x8", "is not 8x8 views of at least 48 px"),
    ],
)
def test_check_live_reads_the_layout_or_names_it(
    tmp_path: Path,
    size_px: tuple[int, int],
    query: str,
    wanted: tuple[int, ...] | str,
) -> None:
    grey = np.full((size_px[1], size_px[0], 3), 90, np.uint8)
    path = write_film(tmp_path / "views.avi", [grey] * 3)
    text = f"live:file:{path}{query}"
    assert is_live(Path(text)) and not is_live(path)
    if isinstance(wanted, str):
        with pytest.raises(UserError) as refused:
            check_live(text, Config())
        assert wanted in f"{refused.value.message} {refused.value.remedy}"
    else:
        live = check_live(text, Config())
        assert (live.rows, live.cols, live.width_px, live.height_px) == wanted


class Camera:
    """A camera whose frames a test gives."""

    def __init__(self, stamps_ns: list[int], level: int) -> None:
        self.info = SourceInfo("camera", (64, 48), 30.0, live=True)
        self._stamps = iter(enumerate(stamps_ns))
        self._level = level

    def read(self, out: np.ndarray) -> Frame | None:
        number, t_ns = next(self._stamps, (0, 0))
        out[:] = self._level
        return Frame(number, t_ns, t_ns) if t_ns else None

    def close(self) -> None: ...


def test_cameras_in_a_row_are_paired_by_time() -> None:
    ms = 1_000_000
    left = Camera([ms * t for t in range(100, 9000, 33)], 100)
    right = Camera([ms * t for t in range(40, 9000, 33)], 100)  # two frames early, then 6 ms late
    row = RowSource([left, right], (64, 48))
    out = np.empty((48, 128, 3), np.uint8)
    assert row.info.size_px == (128, 48)
    frames = []
    while (frame := row.read(out)) is not None:
        frames.append(frame)
        assert frame.offset_ns <= 17 * ms
    assert len(frames) > 200 and frames[0].t_sensor_ns == 100 * ms


@pytest.mark.parametrize("phases_ms", [(0, 11, 22), (0, 30, 0), (5, 0, 20, 12), (0, 1, 200)])
def test_of_cameras_with_any_phases_the_nearest_frames_are_shown_at_the_full_rate(
    phases_ms: tuple[int, ...],
) -> None:
    ms = 1_000_000
    sources = [Camera([ms * (p + 33 * k + 1) for k in range(100)], 100) for p in phases_ms]
    row = RowSource(sources, (64, 48))
    out = np.zeros((48, 64 * len(sources), 3), np.uint8)
    frames = []
    while (frame := row.read(out)) is not None:
        frames.append(frame)
    gaps = np.diff(sorted(p % 33 for p in phases_ms), append=33 + min(p % 33 for p in phases_ms))
    nearest_ms = 33 - max(gaps)
    assert {round(frame.offset_ns / ms) for frame in frames} == {nearest_ms}
    assert len(frames) >= 99 - max(phases_ms) // 33, "no frame waits for a better one"


def test_check_live_reads_cameras_in_a_row(tmp_path: Path) -> None:
    grey = np.full((96, 128, 3), 90, np.uint8)
    paths = [write_film(tmp_path / f"{name}.avi", [grey] * 3) for name in "ab"]
    text = f"live:file:{paths[0]},file:{paths[1]}"
    live = check_live(f"{text}?size=128x96", Config())
    assert (live.rows, live.cols, live.width_px, live.height_px) == (1, 2, 128, 96)
    for wrong in (f"live:file:{paths[0]},file:{paths[0]}", "live:demo,demo,demo,demo,demo"):
        with pytest.raises(UserError, match="different cameras"):
            check_live(wrong, Config())
