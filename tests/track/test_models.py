"""The face networks without the package mediapipe: fetched by a fake installer, taken from wheels
good and bad.
"""

import stat
import sys
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner

from lfpipe.cli import cli
from lfpipe.errors import UserError
from lfpipe.track import models
from lfpipe.track.engine import LitertNetworks
from lfpipe.track.litert_engine import LitertEngine


@pytest.fixture(scope="module")
def contents() -> dict[str, bytes]:
    found = {relative: models.find_model(relative) for relative in models.SHA256}
    return {
        f"mediapipe/{relative}": path.read_bytes()
        for relative, path in found.items()
        if path is not None
    }


@pytest.fixture
def wheel(tmp_path: Path, contents: dict[str, bytes]) -> Path:
    return write_wheel(tmp_path / "mediapipe-0.10.21-cp312-cp312-any.whl", contents)


@pytest.fixture
def bare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without the package and without an installer; returns where the networks will be
    kept.
    """
    monkeypatch.setattr(models, "package_folder", lambda: None)
    monkeypatch.delenv("UV", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return tmp_path / "data" / "lfpipe" / "models"


def write_wheel(path: Path, contents: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in contents.items():
            archive.writestr(name, content)
    return path


def test_networks_of_a_wheel_run_without_the_package(bare: Path, wheel: Path) -> None:
    assert len(models.missing_models()) == len(models.SHA256)
    with pytest.raises(UserError, match=r"face_landmark\.tflite is missing.*\n.*lfpipe models get"):
        LitertEngine()
    assert models.install_models(wheel) == bare
    assert not models.missing_models()
    assert str(bare) in str(models.find_model("modules/face_landmark/face_landmark.tflite"))
    assert "mediapipe 0.10.21" in LitertEngine(LitertNetworks()).model
    done = CliRunner().invoke(cli, ["models", "get", "--from", str(wheel)])
    assert [line.split()[0] for line in done.stdout.splitlines()] == [
        sha256[:8] for sha256 in models.SHA256.values()
    ]


@pytest.mark.parametrize("damage", ["truncated", "text", "without", "changed", "absent", "folder"])
def test_a_bad_wheel_changes_nothing(
    bare: Path, tmp_path: Path, contents: dict[str, bytes], damage: str
) -> None:
    path = tmp_path / "bad.whl"
    network = "mediapipe/modules/face_landmark/face_landmark.tflite"
    if damage == "truncated":
        path.write_bytes(write_wheel(path, contents).read_bytes()[:-100])
    elif damage == "text":
        path.write_text("no wheel")
    elif damage == "without":
        write_wheel(path, {name: content for name, content in contents.items() if name != network})
    elif damage == "changed":
        write_wheel(path, contents | {network: contents[network][:-1] + b"\0\0"})
    elif damage == "folder":
        path.mkdir()
    with pytest.raises(UserError, match=r"bad\.whl") as error:
        models.install_models(path)
    assert "0.10.21" in error.value.remedy
    assert not bare.exists()


def fake_installer(path: Path, lines: str) -> None:
    path.write_text(f"#!{sys.executable}\nimport sys, shutil, pathlib\n{lines}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


@pytest.mark.parametrize("tool", ["uv", "pip"])
def test_either_installer_fetches_by_name_and_says_so(
    bare: Path, wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tool: str
) -> None:
    if tool == "pip":
        monkeypatch.setattr("importlib.util.find_spec", lambda name: name == "pip" or None)
        monkeypatch.setattr(models, "python", lambda _, *words: [str(tmp_path / "pip"), *words])
    fake_installer(
        tmp_path / tool,
        "assert 'mediapipe==0.10.21' in sys.argv\n"
        "there = sys.argv[sys.argv.index('--target') + 1]\n"
        f"shutil.unpack_archive({str(wheel)!r}, there, 'zip')",
    )
    said: list[str] = []
    assert models.fetch_models(said.append) == bare
    assert "36 MB" in said[0] and str(bare) in said[1]
    assert not models.missing_models()
