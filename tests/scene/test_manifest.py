"""Manifest: the keys of manifest.json, and of what `lfpipe scene` prints with --json."""

import json
from pathlib import Path

import pytest

from tests.scene import made
from tests.scene.test_cli import Shell

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
        "half_turn": bool,
        "half_turn_sure": bool,
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
    },
    "notes": list,
    "scores": {"nearest": float, "blend": float, "warp": float, "warp2": float},
    "method": str,
}
FACTS = {
    **{
        name: MANIFEST[name]
        for name in (
            *("name", "source", "layout", "rows", "cols", "height", "width", "channels"),
            *("bit_depth", "frames", "frame_rate_hz", "flips", "geometry", "gamma", "gamma_by"),
            "notes",
        )
    },
    "orientation_evidence": MANIFEST["orientation"],
    "disparity": {
        "min": float,
        "max": float,
        "source": str,
        "scale_px": float,
        "border_low_px": float,
        "border_high_px": float,
    },
    "views_missing": list,
    "irregular": bool,
    "method": str,
    "scores_db": MANIFEST["scores"],
    "pack": str,
    "pack_bytes": int,
}


def kinds(value: object) -> object:
    """The types of a JSON value, by key of its objects."""
    if isinstance(value, dict):
        return {key: kinds(item) for key, item in value.items()}
    return None if value is None else type(value)


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Shell:
    return Shell(tmp_path_factory.mktemp("cache") / "cache")


def test_manifest_and_json_of_a_pack_have_their_keys(shell: Shell, tmp_path: Path) -> None:
    folder = made.write_grid(tmp_path / "reversed", made.views(5, 5)[::-1, ::-1])
    unpacked = shell.json("info", folder)
    assert kinds(unpacked) == {**FACTS, "method": None, "pack": None, "scores_db": {}}
    facts = shell.json("pack", folder)
    stored = json.loads((Path(facts["pack"]) / "manifest.json").read_text())
    assert len(stored.pop("checksum")) == 32 and kinds(stored) == MANIFEST
    assert kinds(facts) == {"pack": str, "needs_tracking": bool, "checksum": str, **MANIFEST}
    packed = shell.json("info", folder)
    assert kinds(packed) == FACTS
    sizes = ("layout", "rows", "cols", "height", "width", "channels", "bit_depth", "frames")
    assert [packed[name] for name in sizes] == ["rows-cols", 5, 5, 96, 128, 3, 8, 1]
    shown = ({"rows": True, "cols": True, "transpose": False}, stored["orientation"])
    for told in (unpacked, packed):
        assert (told["flips"], told["orientation_evidence"]) == shown
        assert told["disparity"]["min"] == pytest.approx(-1, abs=0.3)
        assert told["disparity"]["max"] == pytest.approx(2, abs=0.4)
    assert (stored["flips"]["rows"], stored["disparity"]["max_px"]) == (
        False,
        pytest.approx(1, abs=0.3),
    )
    assert facts["flips"] == shown[0]
    assert facts["disparity"]["max_px"] == -stored["disparity"]["min_px"]
    assert facts["disparity"]["border_low_px"] == -stored["disparity"]["border_high_px"]


def test_json_of_what_was_not_measured_is_null(shell: Shell, tmp_path: Path) -> None:
    made.write(tmp_path / "photo.png", made.texture(60, 80, 3))
    told = shell.json("info", tmp_path / "photo.png")
    assert (told["disparity"]["min"], told["disparity"]["max"]) == (None, None)
    assert (told["disparity"]["source"], told["views_missing"]) == ("unknown", [])
    pack = shell.json("pack", tmp_path / "photo.png")
    assert (pack["disparity"]["source"], pack["method"], pack["scores"]) == ("none", "nearest", {})


def test_list_tells_each_pack_and_a_damaged_one(shell: Shell, tmp_path: Path) -> None:
    made.write(tmp_path / "a.png", made.texture(60, 80, 3))
    pack = Path(shell.json("pack", tmp_path / "a.png")["pack"])
    keys = {"key", "bytes", "name", "source", "layout", "rows", "cols", "frames", "height", "width"}
    listed = {told["key"]: told for told in shell.json("list")["packs"]}
    assert set(listed[pack.name]) == {*keys, "created"}
    (pack / "manifest.json").write_text("{}")
    (damaged,) = [told for told in shell.json("list")["packs"] if told["key"] == pack.name]
    assert set(damaged) == {*keys, "created"} and damaged["name"] is None
    assert "damaged" in shell.text("list")
    shell.text("clean", pack.name)
    assert not pack.exists()
