"""Words in the picture, steps of depth, and the picture of the glasses test."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import attrs
import numpy as np
import pytest

from lfpipe.config import Config, Render, SessionOptions, choices
from lfpipe.config.modes import Window
from lfpipe.config.tree import Anaglyph
from lfpipe.render.display.display import Notice
from lfpipe.render.synthesis.anaglyph import MATRICES
from lfpipe.render.ui.files import Files
from lfpipe.render.ui.notices import SHOWN_NS, ChangeNotices, Notices, for_window
from lfpipe.render.ui.pages import glasses_test
from lfpipe.render.ui.recording import RecordingIndicator
from lfpipe.render.ui.scenes import OPEN, SceneLoader
from lfpipe.scene.lightfield import HARDLY_FIT, Manifest
from lfpipe.sequence.folder import MANIFEST
from lfpipe.transport.clock import SECOND_NS, now_ns
from lfpipe.transport.control import Answer


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
    ("error", "remedy", "shown"),
    [
        ("no camera found", "plug it in, or use --camera demo", "No camera found."),
        (
            "/tmp/x/fern: the folder is empty",
            "give a folder",
            "fern: the folder is empty: give a folder.",
        ),
        ("the camera is busy", "use `lfpipe ctl stop`\nor", "The camera is busy."),
        ("a: bad\nmore", "use --set scene.force=true", "A: bad."),
    ],
)
def test_errors_in_the_window_name_no_paths_and_commands(
    error: str, remedy: str, shown: str
) -> None:
    assert for_window(error, remedy) == shown


@pytest.mark.parametrize("lock_code", ["", "1"])
def test_views_that_hardly_fit_are_named_once_in_a_window_that_is_not_locked(
    lock_code: str,
) -> None:
    field = SimpleNamespace(
        name="album",
        depth_inverted=False,
        rows=4,
        cols=5,
        manifest=Manifest(notes=(HARDLY_FIT,)),
    )
    context: Any = SimpleNamespace(
        config=Config(), options=SessionOptions(display=Window(lock_code=lock_code))
    )
    viewer: Any = SimpleNamespace(field=field)
    shown = Notices()
    ChangeNotices(context, viewer, shown, Files(context)).show_doubts()
    told = [notice.text for notice in shown.current(now_ns(), [])]
    assert told == ([] if lock_code else ["These 20 pictures hardly fit together."])


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


@pytest.mark.parametrize("anaglyph", ["side-by-side", "row-interleaved"])
def test_glasses_test_gives_screens_of_two_views_both(anaglyph: Anaglyph) -> None:
    picture, pair = glasses_test(Render(anaglyph=anaglyph), (320, 200))
    assert picture.shape == (200, 320, 3) and pair is not None and (pair[0] != pair[1]).any()


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
    recording.answered()
    context.options.record = path
    recording.update(0)
    context.options.record = ""
    recording.update(20 * SECOND_NS)
    assert not any(path in text for text in texts(notices)), "it is still written"
    Path(path).mkdir()
    (Path(path) / MANIFEST).touch()
    recording.update(20 * SECOND_NS + 1)
    assert texts(notices) == [f"Camera recorded, 20 s: {path}"]


def loader(notices: Notices, **more: object) -> tuple[SceneLoader, list[dict[str, object]]]:
    """A loader of a session with such options, and the requests that it makes."""
    asked: list[dict[str, object]] = []
    context = SimpleNamespace(
        options=SimpleNamespace(
            **{
                "lock_code": "",
                "every_s": 0.0,
                "playlist": (),
                "playlist_at": 0,
                "unusable": {},
                **more,
            }
        ),
        row={"t_face_ns": SECOND_NS},
        request=lambda word, **words: asked.append({word: words}),
    )
    return SceneLoader(context, notices), asked  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("code", "at", "alone_s", "loads"),
    [("bye42", 2, 61, 1), ("bye42", 2, 59, 0), ("bye42", 0, 99, 0), ("", 2, 99, 0)],
)
def test_scene_loader_of_a_locked_window_begins_with_the_first_scene_for_the_next_visitor(
    code: str, at: int, alone_s: int, loads: int
) -> None:
    scenes, asked = loader(Notices(), lock_code=code, playlist_at=at)
    for _ in range(3):  # asked for once, however often it is looked at
        scenes.serve((1 + alone_s) * SECOND_NS)
    assert asked == [{"load": {"at": 0}}] * loads


def test_scene_loader_of_a_locked_window_shows_each_scene_for_its_time() -> None:
    options = {"lock_code": "bye42", "every_s": 5.0, "playlist": ("/a", "/b"), "playlist_at": 1}
    scenes, asked = loader(Notices(), **options)
    for second in range(200, 230):  # with nobody there, too
        scenes.serve(second * SECOND_NS)
    assert asked == [{"load": {"step": 1}}], "the next one waits while this one is loaded"
    scenes.handle(Answer.of({"cmd": "load", "ok": False, "error": "no other scene"}))
    for second in range(230, 237):
        scenes.serve(second * SECOND_NS)
    assert asked == [{"load": {"step": 1}}] * 2


def test_scene_loader_reports_progress_and_what_cannot_be_opened() -> None:
    notices = Notices()
    scenes, asked = loader(notices, playlist=("/a", "/b"))

    def shown() -> list[str]:
        return list(filter(None, (*texts(notices), scenes.status())))

    def report(scene: str, step: str) -> None:
        scenes.report({"scene": scene, "step": step, "shown": False, "share": 0.5})

    report("/x/boxes", "opening")
    assert shown() == ["Opening boxes"], "at once: the timer of a kiosk waits for any load"
    report("/x/boxes", "views 3 of 6")
    assert shown() == ["Opening boxes: reading pictures, 50 %"]
    report("/x/boxes", "")
    assert shown() == []
    scenes.step(1)
    assert shown() == ["Opening ..."]
    report("/b", "disparity 3 of 6")
    assert shown() == ["Opening b (scene 2 of 2): measuring depth, 50 %"]
    scenes.step(1)  # from the one that is on its way, which it replaces
    scenes.handle(Answer.of({"cmd": "load", "ok": False, "error": "replaced", "replaced": True}))
    assert asked == [{"load": {"step": 1}}, {"load": {"step": 2}}]
    scenes.handle(Answer.of({"cmd": "load", "ok": True, "note": "2 scenes; 3 other pictures"}))
    assert shown() == ["2 scenes; 3 other pictures"]


def test_captions_stand_beside_the_scenes(tmp_path: Path) -> None:
    (tmp_path / "captions.txt").write_text("bust: Antinous | Marble\nquilt.png: A quilt\n")
    scenes, _ = loader(Notices(), playlist=(f"{tmp_path}/bust", f"{tmp_path}/other"))
    assert scenes.caption("bust") == ("Antinous", "Marble")
    other, _ = loader(Notices(), playlist=(f"{tmp_path}/other",))
    assert other.caption("other") == ("other", "")
