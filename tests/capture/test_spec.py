"""Names of sources; the errors for wrong ones: messages.py."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe import config
from lfpipe.capture.open_source import clock_of, open_source
from lfpipe.capture.spec import CameraSpec, DemoSpec, FileSpec, parse_source, playing_once
from lfpipe.config.modes import Live
from lfpipe.errors import UserError
from lfpipe.plugins import SOURCES, entries
from tests.support.refusal import refusal
from tests.support.world import write_package


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


def test_unknown_kind_is_refused_with_the_kinds() -> None:
    refused = refusal(parse_source, "rtps://me:secret@host/stream")
    assert "not a frame source" in refused.message and "secret" not in str(refused)
    assert all(form in refused.remedy for form in ("camera:NAME", "file:PATH", "demo"))


def test_source_of_another_package_is_parsed_and_blamed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_package(tmp_path, f"[{SOURCES}]\nmine = mine:Mine\n", "mine")
    (tmp_path / "mine.py").write_text(
        "from lfpipe.capture.spec import SourceKind\n"
        "class Mine(SourceKind):\n"
        "    form, live = 'mine:N', True\n"
        "    parse = classmethod(lambda cls, rest: cls() if rest == '1' else None)\n"
        "    def open(self, camera): raise KeyError(1)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    entries.cache_clear()
    try:
        assert parse_source("mine:1").live and clock_of("mine:1") == Live()
        assert "mine:..." in refusal(parse_source, "mine:2").remedy
        assert "mine of mine 1.0" in refusal(open_source, "mine:1", config.Camera()).message
    finally:
        entries.cache_clear()


@given(st.text(max_size=40), st.sampled_from(["", "camera:", "file:", "file:a?", "demo"]))
def test_any_text_is_read_or_refused(text: str, scheme: str) -> None:
    try:
        spec = parse_source(scheme + text)
    except UserError:
        return
    assert isinstance(spec, CameraSpec | FileSpec | DemoSpec)
