"""Which device is the camera: listed, found again, distinguished from others of its model."""

import shutil
from pathlib import Path

import pytest

from lfpipe.capture.camera_list import CameraFinder, NoCamera, by_name, cameras, nodes
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


def test_only_devices_that_exist_are_listed(tmp_path: Path) -> None:
    dev = _kernel(tmp_path, video10=("Camera 10", "usb1"), video2=("Camera 2", "usb2"))
    # no driver answers: listed, to see what is wrong
    found = [(camera.path.name, camera.name) for camera in cameras()]
    assert found == [("video2", "Camera 2"), ("video10", "Camera 10")]
    for name in ("video10", "video2"):
        (dev / name).unlink()
    assert cameras() == []


class Plugs:
    """A finder, and the devices that it sees."""

    def __init__(
        self, root: Path, monkeypatch: pytest.MonkeyPatch, spec: CameraSpec | None = None
    ) -> None:
        self._root = root
        self.metadata = set[str]()
        monkeypatch.setattr(
            "lfpipe.capture.camera_list._captures",
            lambda device: device.path.name not in self.metadata,
        )
        self.finder = CameraFinder(spec or CameraSpec(_kernel(root) / "video0"))

    def found(self, **devices: tuple[str, str]) -> str:
        """The device that is found among these; "" if none is."""
        _kernel(self._root, **devices)
        try:
            return self.finder.path().name
        except UserError as error:
            assert "unplugged" in error.message
            return ""


def test_a_camera_is_found_again_by_its_place_and_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugs = Plugs(tmp_path, monkeypatch)
    assert plugs.found(video0=("Cam", "usb2"), video2=("Other", "usb3")) == "video0"
    assert plugs.found(video0=("Other", "usb3"), video3=("Cam", "usb2")) == "video3", (
        "same place and name"
    )
    assert plugs.found(video0=("Other", "usb3")) == "", "another camera at its number is not it"
    assert plugs.found(video0=("Other", "usb3"), video5=("Cam", "usb9")) == "video5", (
        "plugged in elsewhere"
    )
    assert plugs.found(video5=("Cam", "usb9")) == "video5"


def test_the_first_camera_may_come_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plugs = Plugs(tmp_path, monkeypatch)
    plugs.finder = CameraFinder(None)
    with pytest.raises(NoCamera):
        plugs.finder.path()
    assert plugs.found(video4=("Cam", "usb2"), video5=("Other", "usb3")) == "video4"
    assert plugs.found(video5=("Other", "usb3")) == "", "from then on it is that one"


def test_a_metadata_node_at_the_old_number_is_not_the_camera(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Replugged while another device holds a number, the picture node moves up and the metadata
    node takes its place.
    """
    plugs = Plugs(tmp_path, monkeypatch, CameraSpec(Path(), "Cam"))
    plugs.metadata = {"video2"}
    assert plugs.found(video1=("Cam", "usb1"), video2=("Cam", "usb1")) == "video1"
    plugs.metadata = {"video1"}
    assert plugs.found(video0=("Cam", "usb1"), video1=("Cam", "usb1")) == "video0"


def test_another_camera_of_the_model_does_not_take_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugs = Plugs(tmp_path, monkeypatch)
    assert plugs.found(video0=("Cam", "usb1"), video1=("Cam", "usb2")) == "video0"
    for _ in range(3):
        assert plugs.found(video1=("Cam", "usb2")) == "", "the twin was there before"
    assert plugs.found(video1=("Cam", "usb2"), video4=("Cam", "usb1")) == "video4"
    assert plugs.found(video1=("Cam", "usb2")) == ""
    assert plugs.found(video1=("Cam", "usb2"), video3=("Cam", "usb7")) == "video3", (
        "the camera, at another port"
    )


def test_a_name_means_one_camera(tmp_path: Path) -> None:
    _kernel(tmp_path, video0=("Integrated Camera", "a"), video1=("Cam", "b"), video2=("CAM", "c"))
    assert CameraFinder(CameraSpec(Path("/dev/video96"))).path() == Path("/dev/video96"), (
        "one that is not there yet"
    )
    assert by_name("integrated", nodes()).path.name == "video0"
