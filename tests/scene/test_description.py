"""`lightfield.toml`: it comes before detection, and settings of the session before it."""

from pathlib import Path

import pytest

from lfpipe import config
from lfpipe.errors import UserError
from lfpipe.scene.analysis import FILE, analyse_scene, checked_source, describe_folder
from lfpipe.scene.pack import packed
from lfpipe.scene.packing import pack_scene
from tests.scene import made
from tests.support.refusal import refusal


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """12 numbered views, which 3x4, 4x3 and 2x6 would explain."""
    path = tmp_path / "scene"
    made.write_grid(path, made.views(3, 4), "view{n:02d}.png")
    return path


@pytest.fixture
def settings(tmp_path: Path) -> config.Scene:
    return config.Scene(cache_dir=str(tmp_path / "cache"))


def test_stated_grid_and_depth_order_come_before_detection(
    folder: Path, settings: config.Scene
) -> None:
    assert pack_scene(folder, settings).rows == 3
    (folder / FILE).write_text('[scene]\ngrid = "2x6"\ninvert_depth = "yes"\n')
    assert packed(folder, settings) is None, "the pack of before does not serve"
    field = pack_scene(folder, settings)
    assert (field.rows, field.cols) == (2, 6)
    facts = field.manifest.orientation
    assert facts.invert_depth and facts.depth_order_sure and field.depth_inverted
    assert any(FILE in note for note in field.manifest.notes)
    again = packed(folder, settings)
    assert again is not None and again.folder == field.folder


def test_settings_of_the_session_come_before_the_file(folder: Path, settings: config.Scene) -> None:
    (folder / FILE).write_text('[scene]\ngrid = "2x6"\n')
    asked = config.updated(
        config.Config(), {"scene.grid": "4x3", "scene.cache_dir": settings.cache_dir}
    )
    assert checked_source(folder, asked.scene)[0].rows == 4


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[scene]\ngrid = 7\n", "grid"),
        ('[scene]\ngird = "2x6"\n', "gird"),
        ('[scene]\ncache_dir = "/tmp/x"\n', "cache_dir"),
        ("[render]\nalpha_px = 7\n", "render"),
        ("written_by = 7\n", "written_by"),
        ("scene = 7\n", "scene"),
        ("[scene", FILE),
        ("x" * 20_000, FILE),
    ],
)
def test_damaged_file_is_refused_with_a_remedy(
    folder: Path, settings: config.Scene, text: str, named: str
) -> None:
    (folder / FILE).write_text(text)
    error = refusal(analyse_scene, folder, settings)
    assert named in error.message and FILE in error.message
    assert "scene describe" in error.remedy


def test_describe_writes_what_is_given_and_replaces_only_its_own_file(folder: Path) -> None:
    describe_folder(folder, config.Scene(grid="2x6"))
    path = describe_folder(folder, config.Scene(grid="4x3", invert_depth="no"))
    assert checked_source(folder, config.Scene())[0].rows == 4
    path.write_text('[scene]\ngrid = "2x6"\n')
    for settings in (config.Scene(grid="4x3"), config.Scene()):
        with pytest.raises(UserError):
            describe_folder(folder, settings)
    assert checked_source(folder, config.Scene())[0].rows == 2
