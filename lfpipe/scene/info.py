"""Facts about a scene, for people and programs: from its pack, or from an examination if there is
none yet.
"""

from pathlib import Path
from typing import Any

import attrs
import numpy as np

from lfpipe.scene.examination import Examined
from lfpipe.scene.lightfield import Geometry, LightField
from lfpipe.scene.packing import manifest_of

_NAMES = (
    "name",
    "source",
    "layout",
    "rows",
    "cols",
    "height",
    "width",
    "channels",
    "bit_depth",
    "frames",
    "frame_rate_hz",
    "flips",
    "geometry",
    "gamma",
    "gamma_by",
    "notes",
)


def _facts(manifest: dict[str, Any], low_px: float | None, high_px: float | None) -> dict[str, Any]:
    about = dict(manifest["disparity"])
    del about["min_px"], about["max_px"]
    present = manifest["present"]
    return {
        **{name: manifest[name] for name in _NAMES},
        "orientation_evidence": manifest["orientation"],
        "disparity": {"min": low_px, "max": high_px, **about},
        "views_missing": [
            [r, c]
            for r, line in enumerate(present)
            for c, is_present in enumerate(line)
            if not is_present
        ],
        "irregular": manifest["offsets"] is not None,
    }


def pack_facts(field: LightField) -> dict[str, Any]:
    """The facts of `lfpipe scene info --json`."""
    size = sum(file.stat().st_size for file in Path(field.folder).glob("*"))
    return {
        **_facts(field.manifest, field.disparity_min_px, field.disparity_max_px),
        "method": field.method,
        "scores_db": field.manifest["scores"],
        "pack": field.folder,
        "pack_bytes": size,
    }


def scene_facts(scene: Examined) -> dict[str, Any]:
    """The facts of an unpacked scene, with the keys of `pack_facts`: facts that need packing are
    None or empty.
    """
    manifest = manifest_of(scene)
    depth = scene.orientation.depth
    low, high = (depth["min_px"], depth["max_px"]) if depth else (None, None)
    if depth and scene.orientation.half_turn:
        low, high = -depth["max_px"], -depth["min_px"]
    manifest["flips"] = attrs.asdict(scene.orientation.turn)
    manifest["disparity"]["source"] = "estimated" if depth else "unknown"
    facts = _facts(manifest, low, high)
    return {**facts, "method": None, "scores_db": {}, "pack": None, "pack_bytes": 0}


def lines(facts: dict[str, Any]) -> list[str]:
    """The same facts for people."""
    order, flips = facts["orientation_evidence"], facts["flips"]
    words = {
        "rows": "rows reversed",
        "cols": "columns reversed",
        "transpose": "rows and columns exchanged",
    }
    turned = " and ".join(text for name, text in words.items() if flips[name])
    size = "{rows}x{cols} views of {width}x{height} px".format(**facts)
    out = [f"{facts['name']}: {size}, layout {facts['layout']}"]

    def say(what: str, text: str) -> None:
        out.append(f"  {what:11} {text}")

    tone = f", gamma {facts['gamma']:g} ({facts['gamma_by']})" if facts["gamma"] != 1 else ""
    say(
        "depth", f"{facts['bit_depth']} bit, {'colour' if facts['channels'] == 3 else 'grey'}{tone}"
    )
    say(
        "order",
        f"{turned or 'as in the files'}: {order['said']}"
        f" ({order['by']}{', sure' if order['sure'] else ''})",
    )
    if order["undecided"]:
        say("undecided", order["undecided"])
    if facts["frames"] > 1:
        say("video", f"{facts['frames']} frames at {facts['frame_rate_hz']:g} Hz")
    disparity = facts["disparity"]
    if disparity["source"] in ("unknown", "none"):
        say(
            "disparity",
            "none" if disparity["source"] == "none" else "measured when the scene is packed",
        )
    else:
        where = "" if facts["pack"] else " from a few views"
        say(
            "disparity",
            f"{disparity['min']:+.2f} to {disparity['max']:+.2f} px per view,"
            f" {disparity['source']}{where}",
        )
    units = [(*name.rsplit("_", 1), value) for name, value in facts["geometry"].items() if value]
    say(
        "geometry",
        ", ".join(f"{name.replace('_', ' ')} {value:g} {unit}" for name, unit, value in units)
        or "not known",
    )
    scores = ", ".join(f"{name} {value:.1f} dB" for name, value in facts["scores_db"].items())
    if facts["method"]:
        say(
            "method",
            facts["method"]
            + (f" (quality when predicting held-out views: {scores})" if scores else ""),
        )
    for note in facts["notes"]:
        say("note", note)
    packed = f"{facts['pack_bytes'] / 1e6:.1f} MB in {facts['pack']}"
    say("pack", packed if facts["pack"] else "none yet: `lfpipe scene pack` or `up` makes it")
    return out


def expected_field(facts: dict[str, Any]) -> LightField:
    """What the pack of a scene with these facts will be, with views and disparities of zeros that
    take no memory, and the method of most scenes.
    """
    rows, cols, height, width = (facts[name] for name in ("rows", "cols", "height", "width"))
    frames = facts["frames"]
    shape = (frames, rows, cols, facts["channels"], height, width)
    half = (frames, rows, cols, (height + 1) // 2, (width + 1) // 2)
    disparity = facts["disparity"]
    warped = disparity["source"] != "none"
    return LightField(
        views=np.broadcast_to(np.uint8(0), shape),
        disparity=np.broadcast_to(np.int8(0), half) if warped else None,
        disparity_scale_px=1.0,
        disparity_min_px=disparity["min"] or 0.0,
        disparity_max_px=disparity["max"] or 0.0,
        disparity_source=disparity["source"],
        offsets=np.zeros((rows, cols, 2), np.float32),
        present=np.ones((rows, cols), bool),
        geometry=Geometry(**facts["geometry"]),
        frame_rate_hz=facts["frame_rate_hz"],
        name=facts["name"],
        method="warp2" if warped else "nearest",
        manifest={"complete": False, "scores": {}},
    )
