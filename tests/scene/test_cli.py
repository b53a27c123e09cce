"""`lfpipe scene` on the command line; the keys of manifest.json, and of what --json prints."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from lfpipe.cli.scene import scene
from lfpipe.errors import UserError
from lfpipe.scene.pack import open_pack
from tests.scene import made


class Shell:
    """Runs `lfpipe scene` with a cache of its own."""

    def __init__(self, cache: Path) -> None:
        self.cache = cache

    def __call__(self, *words: object) -> Result:
        return CliRunner().invoke(
            scene, [*map(str, words), "--set", f"scene.cache_dir={self.cache}"]
        )

    def text(self, *words: object) -> str:
        done = self(*words)
        assert done.exit_code == 0, done.output + repr(done.exception)
        return done.stdout

    def json(self, *words: object) -> Any:
        return json.loads(self.text(*words, "--json"))


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Shell:
    return Shell(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    # rows from the bottom up
    return made.write_grid(tmp_path_factory.mktemp("views") / "scene", made.views(5, 5)[::-1])


def test_view_is_canonical_and_fractions_are_made(
    shell: Shell, folder: Path, tmp_path: Path
) -> None:
    grid = made.views(5, 5)
    out = tmp_path / "v.png"

    def seen(*words: object) -> np.ndarray:
        shell.text("view", folder, "-o", out, "--overwrite", *words)
        return made.read(out)

    assert np.array_equal(seen("--row", 0, "--col", 4), grid[0, 4])
    assert np.array_equal(seen("--row", 1.4, "--col", 2.6, "--method", "nearest"), grid[1, 3])
    assert np.array_equal(seen("--row", 1, "--col", 3, "--method", "warp"), grid[1, 3])
    # half a step to the left of the middle camera
    between = made.views(9, 9, near_px=1.0, far_px=-0.5)[4, 3]
    inner = np.s_[8:-8, 8:-8]
    wrong = {
        m: np.abs(
            seen("--row", 2, "--col", 1.5, "--method", m)[inner].astype(int) - between[inner]
        ).mean()
        for m in ("nearest", "warp")
    }
    assert wrong["warp"] < 0.6 * wrong["nearest"]


@pytest.mark.parametrize(
    ("row", "col", "frame", "message"),
    [
        (5, 0, 0, "--row 5"),
        ("nan", 0, 0, "--row nan"),
        (0, -0.1, 0, "--col -0.1"),
        (0, 0, 1, "--frame 1"),
    ],
)
def test_views_outside_are_refused(
    shell: Shell, folder: Path, tmp_path: Path, row: object, col: object, frame: int, message: str
) -> None:
    refused = shell(
        "view", folder, "-o", tmp_path / "v.png", "--row", row, "--col", col, "--frame", frame
    ).exception
    assert isinstance(refused, UserError) and message in refused.message


LISTED = {"key", "bytes", "name", "source", "layout", "rows", "cols", "frames", "height", "width"}
LISTED |= {"created"}


def test_pack_list_clean(folder: Path, tmp_path: Path) -> None:
    shell = Shell(tmp_path / "cache")
    facts = shell.json("pack", folder)
    pack = Path(facts["pack"])
    assert pack.is_dir() and facts["needs_tracking"] is True
    listed = shell.json("list")["packs"]
    assert [p["key"] for p in listed] == [pack.name] and listed[0]["bytes"] > 5 * 5 * 96 * 128 * 3
    assert set(listed[0]) == LISTED and str(folder) in shell.text("list")
    assert isinstance(shell("clean", "unknown").exception, UserError)
    assert "removed 0 packs" in shell.text("clean")
    field = open_pack(pack)
    assert f"kept, in use or with other files: {pack.name}" in shell.text("clean", "--all")
    assert shell.text("pack", folder).strip() == str(pack)
    del field
    assert "removed 1 pack," in shell.text("clean", "scene")
    assert shell.json("list")["packs"] == []
    damaged = Path(shell.json("pack", folder)["pack"])
    (damaged / "manifest.json").write_text("{}")
    (told,) = shell.json("list")["packs"]
    assert set(told) == LISTED and told["name"] is None and "damaged" in shell.text("list")
    shell.text("clean", damaged.name)
    assert not damaged.exists()


# manifest

MANIFEST = {
    "version": int,
    "complete": bool,
    "lfpipe": str,
    "key": str,
    "name": str,
    "source": str,
    "layout": str,
    "files": int,
    "created": str,
    "rows": int,
    "cols": int,
    "frames": int,
    "height": int,
    "width": int,
    "channels": int,
    "bit_depth": int,
    "frame_rate_hz": float,
    "flips": {"rows": bool, "cols": bool, "transpose": bool},
    "orientation": {
        "by": str,
        "sure": bool,
        "reason": str,
        "undecided": str,
        "invert_depth": bool,
        "depth_order_sure": bool,
    },
    "gamma": float,
    "gamma_by": str,
    "geometry": {"baseline_mm": None, "focus_distance_mm": None, "focal_length_px": None},
    "present": list,
    "offsets": None,
    "disparity": {
        "source": str,
        "scale_px": float,
        "min_px": float,
        "max_px": float,
        "border_low_px": float,
        "border_high_px": float,
        "confirmed": float,
    },
    "notes": list,
    "scores": {"nearest": float, "blend": float, "warp": float, "warp2": float},
    "errors": {"nearest": list, "blend": list, "warp": list, "warp2": list},
    "method": str,
}
FACTS = {**MANIFEST, "pack": str, "pack_bytes": int}


def kinds(value: object) -> object:
    """The types of a JSON value, by key of its objects."""
    if isinstance(value, dict):
        return {key: kinds(item) for key, item in value.items()}
    return None if value is None else type(value)


def test_manifest_and_json_of_a_pack_have_their_keys(shell: Shell, tmp_path: Path) -> None:
    folder = made.write_grid(tmp_path / "reversed", made.views(5, 5)[::-1, ::-1])
    unpacked = shell.json("info", folder)
    assert kinds(unpacked) == {**FACTS, "pack": None, "scores": {}, "errors": {}}
    facts = shell.json("pack", folder)
    stored = json.loads((Path(facts["pack"]) / "manifest.json").read_text())
    assert kinds(stored) == MANIFEST
    assert kinds(facts) == {"pack": str, "needs_tracking": bool, **MANIFEST}
    packed = shell.json("info", folder)
    assert kinds(packed) == FACTS
    sizes = ("layout", "rows", "cols", "height", "width", "channels", "bit_depth", "frames")
    assert [packed[name] for name in sizes] == ["rows-cols", 5, 5, 96, 128, 3, 8, 1]
    shown = ({"rows": True, "cols": True, "transpose": False}, stored["orientation"])
    for told in (unpacked, packed):
        assert (told["flips"], told["orientation"]) == shown
        assert told["disparity"]["min_px"] == pytest.approx(-1, abs=0.3)
        assert told["disparity"]["max_px"] == pytest.approx(2, abs=0.4)
    assert (stored["flips"]["rows"], stored["disparity"]["max_px"]) == (
        False,
        pytest.approx(1, abs=0.3),
    )
    assert facts["flips"] == shown[0]
    assert facts["disparity"]["max_px"] == -stored["disparity"]["min_px"]
    assert facts["disparity"]["border_low_px"] == -stored["disparity"]["border_high_px"]


def test_info_for_people_names_the_override(shell: Shell, folder: Path, tmp_path: Path) -> None:
    assert "rows reversed" in shell.text("info", folder)
    assert "set by scene.flip" in shell.text("info", folder, "--flip", "both")
    same = made.write_grid(
        tmp_path / "same", np.broadcast_to(made.texture(48, 64, 2), (2, 2, 48, 64, 3))
    )
    assert "nothing moves between these pictures" in shell.text("info", same)
