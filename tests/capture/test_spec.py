"""Names of sources, and the errors for wrong ones."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.capture.open_source import CheckedSource
from lfpipe.capture.spec import CameraSpec, DemoSpec, FileSpec, parse_source, playing_once
from lfpipe.errors import UserError


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("demo", DemoSpec()),
        ("camera:0", CameraSpec(Path("/dev/video0"))),
        ("camera:12", CameraSpec(Path("/dev/video12"))),
        ("camera:/dev/v4l/by-id/usb-x", CameraSpec(Path("/dev/v4l/by-id/usb-x"))),
        ("file:a b/c.mp4", FileSpec(Path("a b/c.mp4"))),
        ("file:a?loop=0", FileSpec(Path("a"), loop=False)),
        ("file:a?loop=1&pace=30", FileSpec(Path("a"), pace=30.0)),
        ("file:a?pace=max&loop=0", FileSpec(Path("a"), loop=False, pace="max")),
        ("file:a?pace=recorded", FileSpec(Path("a"))),
        ("file:what?.mp4?", FileSpec(Path("what?.mp4"))),
    ],
)
def test_reads(text: str, spec: object) -> None:
    assert parse_source(text) == spec


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "one of camera:N"),
        ("fiel:a.mp4", "did you mean 'file:PATH'"),
        ("camera", "did you mean 'camera:0'"),
        ("demo:1", "did you mean 'demo'"),
        ("camera:", "no camera given"),
        ("camera: ", "no camera given"),
        ("file:", "no path given"),
        ("file:?loop=0", "no path given"),
        ("file:a?lop=1", "did you mean 'loop'"),
        ("file:a?speed=1", "'speed'"),
        ("file:a?loop=yes", "loop=yes"),
        ("file:a?pace=recrded", "did you mean 'recorded'"),
        ("file:a?pace=0", "pace=0: out of range"),
        ("file:a?pace=nan", "pace=nan: out of range"),
        ("file:a?pace=inf", "out of range"),
        ("file:a?.mp4", "NAME=VALUE"),
    ],
)
def test_says_what_is_wrong(text: str, says: str) -> None:
    with pytest.raises(UserError) as told:
        parse_source(text)
    assert says in str(told.value)
    assert told.value.remedy


@pytest.mark.parametrize(
    ("text", "once"),
    [
        ("demo", "demo"),
        ("camera:0", "camera:0"),
        ("file:a.mp4", "file:a.mp4?loop=0"),
        ("file:a.mp4?pace=30", "file:a.mp4?pace=30&loop=0"),
        ("file:a.mp4?loop=1", "file:a.mp4?loop=1"),
        ("file:my_loop=2.mp4", "file:my_loop=2.mp4?loop=0"),
        ("file:what?.mp4?", "file:what?.mp4?loop=0"),
    ],
)
def test_a_file_plays_once_unless_its_parameters_name_loop(text: str, once: str) -> None:
    assert playing_once(text) == once
    parse_source(once)


@pytest.mark.parametrize(
    ("text", "lossless"),
    [("file:a?pace=max", True), ("file:pace=max.mp4", False), ("file:a", False), ("demo", False), ("", False)],
)
def test_a_session_loses_no_frame_at_full_pace_whatever_the_name_of_the_file(text: str, lossless: bool) -> None:
    options = CheckedSource(text, 30.0, (64, 48)).options
    assert (options.source, options.source_hz, options.jpeg_px, options.lossless) == (text, 30.0, (64, 48), lossless)


@given(st.text(max_size=40), st.sampled_from(["", "camera:", "file:", "file:a?", "demo"]))
def test_any_text_is_read_or_refused(text: str, scheme: str) -> None:
    try:
        spec = parse_source(scheme + text)
    except UserError:
        return
    assert isinstance(spec, CameraSpec | FileSpec | DemoSpec)
