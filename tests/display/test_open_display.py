"""Values of `--display`."""

import numpy as np
import pytest

from lfpipe.errors import UserError
from lfpipe.render.display import check_display, has_display, open_display


@pytest.fixture(autouse=True)
def no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("window", "no screen here"),
        ("fullscreen", "neither WAYLAND_DISPLAY nor DISPLAY"),
        ("windw", "did you mean 'window'"),
        ("none:", "did you mean 'none'"),
        ("file", "did you mean 'file:OUT.mkv'"),
        ("file:", "not a display"),
        ("file:out.webm", "not .mkv, .avi or .mp4"),
    ],
)
def test_says_what_is_wrong(spec: str, says: str) -> None:
    with pytest.raises(UserError) as told:
        check_display(spec)
    assert says in told.value.message and told.value.remedy


@pytest.mark.parametrize("name", [":97", "unix:97", "localhost:97.0", "rubbish", ":"])
def test_a_named_screen_that_does_not_answer_is_none(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", name)
    assert not has_display()
    with pytest.raises(UserError, match="does not answer"):
        check_display("window")


def test_none_takes_pictures() -> None:
    check_display("none")
    display = open_display("none", (8, 8), "", 30.0)
    first, second = (display.show(np.zeros((8, 8, 3), np.uint8)) for _ in range(2))
    assert 0 < first <= second
    assert display.events() == [] and display.notices() == []
    display.close()
