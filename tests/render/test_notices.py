"""Words in the picture, steps of depth, and the picture of the glasses test."""

from pathlib import Path
from types import SimpleNamespace

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfpipe.config import Config, Render, choices
from lfpipe.config.check import changed
from lfpipe.config.session_options import SessionOptions
from lfpipe.config.tree import Anaglyph
from lfpipe.render.display.display import Notice
from lfpipe.render.synthesis.anaglyph import MATRICES
from lfpipe.render.ui.controller import Ui
from lfpipe.render.ui.pages import glasses_test
from lfpipe.render.ui.scenes import OPEN
from lfpipe.render.ui.settings import SHOWN_NS, Notices, RecordingIndicator, Settings
from lfpipe.sequence.folder import MANIFEST
from lfpipe.transport.control import Answer
from lfpipe.transport.ring import SECOND_NS, now_ns


def texts(notices: Notices) -> list[str]:
    return [notice.text for notice in notices.current(now_ns(), [])]


def test_notices_pass_and_states_stay() -> None:
    notices = Notices()
    t_ns = now_ns()
    notices.show("mode", "mode: grey")
    notices.show("mode", "mode: mono", items=(OPEN,))
    standing = [Notice(""), Notice("paused")]
    mono = Notice("mode: mono", (OPEN,))
    assert notices.current(t_ns + SHOWN_NS - 1, standing) == (mono, Notice("paused"))
    assert notices.current(now_ns() + SHOWN_NS, standing) == (Notice("paused"),)


@pytest.mark.parametrize(
    "anaglyph", [name for name in choices("render.anaglyph") if name in MATRICES]
)
def test_glasses_test_draws_each_letter_in_its_own_channels(anaglyph: Anaglyph) -> None:
    render = Render(anaglyph=anaglyph)
    plain, swapped = (
        glasses_test(attrs.evolve(render, swap_eyes=swap), (320, 200))[0].astype(int)
        for swap in (False, True)
    )
    assert np.abs(plain - swapped).max() > 60, "swapped, the letters change their eyes"
    left, right = plain[:, 20:150], plain[:, 170:300]
    contrast = [[int(np.ptp(half[..., channel])) for channel in range(3)] for half in (left, right)]
    assert max(contrast[0]) > 100 and max(contrast[1]) > 100
    for eye in (0, 1):
        channel = 2 - int(np.argmax(contrast[eye]))  # of a picture in BGR
        shares = np.sum(MATRICES[anaglyph][channel], axis=1)
        assert shares[eye] > shares[1 - eye], "a letter stands out in channels of its own eye"


@pytest.mark.parametrize("paused", [False, True])
def test_a_recording_starts_at_once_and_resumes(
    paused: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setenv("XDG_VIDEOS_DIR", str(tmp_path / "Videos"))
    notices = Notices()
    asked: list[tuple[str, str]] = []
    context = SimpleNamespace(
        options=SimpleNamespace(record=""),
        paused=paused,
        request=lambda word, path="": asked.append((word, path)),
    )
    recording = RecordingIndicator(context, notices)  # type: ignore[arg-type]
    recording.toggle()
    recording.toggle()  # at a second press, as long as the first is not answered, nothing
    assert texts(notices) == ["Starting the recording ..."]
    *before, (word, path) = asked
    assert before == [("resume", "")] * paused and word == "record"
    assert Path(path).parent == tmp_path / "Videos" and Path(path).parent.is_dir()
    recording.is_requested = False
    context.options.record = path
    recording.update(0)
    context.options.record = ""
    recording.update(20 * SECOND_NS)
    assert not any(path in text for text in texts(notices)), "it is still written"
    Path(path).mkdir()
    (Path(path) / MANIFEST).touch()
    recording.update(20 * SECOND_NS + 1)
    assert texts(notices) == [f"Camera recorded, 20 s: {path}"]


@given(st.lists(st.booleans(), max_size=12))
def test_each_key_turns_the_eyes_however_late_the_answers_are(is_key: list[bool]) -> None:
    sent: list[dict[str, object]] = []
    context = SimpleNamespace(
        config=Config(), options=SessionOptions(), request=lambda _, set: sent.append(set)
    )
    viewer = SimpleNamespace(field=SimpleNamespace(name="", depth_inverted=False))
    settings = Settings(context, viewer, Notices(), None)  # type: ignore[arg-type]
    for key in [*is_key, *[False] * len(is_key)]:
        if key:
            settings.set(swap_eyes=not settings.render.swap_eyes)
        elif sent:
            context.config = changed(context.config, sent.pop(0))
            answer = Answer.of({"cmd": "set", "ok": True})
            Ui.handle(SimpleNamespace(settings=settings), answer)  # type: ignore[arg-type]
    assert context.config.render.swap_eyes == bool(sum(is_key) % 2) and not settings.requested
