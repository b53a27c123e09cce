"""Which device is the camera: listed, found again, distinguished from others of its model."""

import shutil
from pathlib import Path

import pytest

from lfpipe.capture.camera_list import CameraFinder
from lfpipe.capture.spec import CameraSpec
from lfpipe.errors import UserError

pytestmark = pytest.mark.native("Video4Linux")


@pytest.fixture(autouse=True)
def own_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfpipe.capture.camera_list.SYS", tmp_path / "sys")
    monkeypatch.setattr("lfpipe.capture.camera_list.DEV", tmp_path / "dev")


def _kernel(root: Path, **devices: tuple[str, str]) -> Path:
    """A /sys and a /dev that list devices by number: (name, bus). Returns /dev."""
    sys, dev = root / "sys", root / "dev"
    for folder in (sys, dev):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
    for number, (name, bus) in devices.items():
        (sys / number).mkdir()
        (sys / number / "name").write_text(f"{name}\n")
        (root / bus).mkdir(exist_ok=True)
        (sys / number / "device").symlink_to(root / bus)
        (dev / number).touch()
    return dev


CAM1, CAM2, OTHER = ("Cam", "usb1"), ("Cam", "usb2"), ("Other", "usb3")
ELSEWHERE = ("Cam", "usb9")  # plugged in at another port
NOBODY, GONE = "no camera found", "unplugged"
# the device that is asked for; and, one after the other, the devices that are there, those of them
# that are for metadata, and the one that is found
STORIES: dict[str, tuple[str, list[tuple[dict[str, tuple[str, str]], set[str], str]]]] = {
    "found again by its place and name": (
        "video0",
        [
            ({"video0": CAM2, "video2": OTHER}, set(), "video0"),
            ({"video0": OTHER, "video3": CAM2}, set(), "video3"),
            ({"video0": OTHER}, set(), GONE),  # another camera at its number is not it
            ({"video0": OTHER, "video5": ELSEWHERE}, set(), "video5"),
            ({"video5": ELSEWHERE}, set(), "video5"),
        ],
    ),
    "the first one may come later": (
        "",
        [
            ({}, set(), NOBODY),
            ({"video4": CAM2, "video5": OTHER}, set(), "video4"),
            ({"video5": OTHER}, set(), GONE),  # from then on it is that one
        ],
    ),
    # replugged while another device holds a number, the picture node moves up and the metadata node
    # takes its place
    "a metadata node at the old number": (
        "Cam",
        [
            ({"video1": CAM1, "video2": CAM1}, {"video2"}, "video1"),
            ({"video0": CAM1, "video1": CAM1}, {"video1"}, "video0"),
        ],
    ),
    "another camera of the model does not take over": (
        "video0",
        [
            ({"video0": CAM1, "video1": CAM2}, set(), "video0"),
            *[({"video1": CAM2}, set[str](), GONE)] * 3,  # the twin was there before
            ({"video1": CAM2, "video4": CAM1}, set(), "video4"),
            ({"video1": CAM2}, set(), GONE),
            ({"video1": CAM2, "video3": ELSEWHERE}, set(), "video3"),
        ],
    ),
}


@pytest.mark.parametrize("story", STORIES)
def test_camera_finder_finds_the_camera_again_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, story: str
) -> None:
    asked, steps = STORIES[story]
    specs = {"": CameraSpec(), "Cam": CameraSpec(Path(), "Cam")}
    finder = CameraFinder(specs.get(asked, CameraSpec(tmp_path / "dev" / asked)))
    for devices, metadata, expected in steps:
        _kernel(tmp_path, **devices)
        monkeypatch.setattr(
            "lfpipe.capture.camera_list._captures",
            lambda device, metadata=metadata: device.path.name not in metadata,
        )
        try:
            assert finder.path().name == expected
        except UserError as error:
            assert expected in error.message
