"""Names of sources; the errors for wrong ones: messages.py."""

from pathlib import Path

import pytest

from lfpipe.capture.spec import CameraSpec, DemoSpec, FileSpec, parse_source, playing_once


@pytest.mark.parametrize(
    ("text", "spec", "once"),
    [
        ("demo", DemoSpec(), "demo"),
        ("camera:12", CameraSpec(Path("/dev/video12")), "camera:12"),
        (
            "camera:/dev/v4l/by-id/usb-x",
            CameraSpec(Path("/dev/v4l/by-id/usb-x")),
            "camera:/dev/v4l/by-id/usb-x",
        ),
        ("camera:Front", CameraSpec(Path(), "Front"), "camera:Front"),
        ("file:a b/c.mp4", FileSpec(Path("a b/c.mp4")), "file:a b/c.mp4?loop=0"),
        ("file:a?loop=1&pace=30", FileSpec(Path("a"), pace=30.0), "file:a?loop=1&pace=30"),
        (
            "file:a?pace=max&loop=0",
            FileSpec(Path("a"), loop=False, pace="max"),
            "file:a?pace=max&loop=0",
        ),
        ("file:a?pace=recorded", FileSpec(Path("a")), "file:a?pace=recorded&loop=0"),
        ("file:my_loop=2.mp4", FileSpec(Path("my_loop=2.mp4")), "file:my_loop=2.mp4?loop=0"),
        ("file:what?.mp4?", FileSpec(Path("what?.mp4")), "file:what?.mp4?&loop=0"),
    ],
)
def test_reads_and_plays_once_unless_parameters_name_loop(
    text: str, spec: object, once: str
) -> None:
    assert parse_source(text) == spec and playing_once(text) == once
    parse_source(once)
