"""Facts about a scene, for people and programs: from its pack, or from an analysis if there is
none yet.
"""

from pathlib import Path
from typing import Any

import attrs
import numpy as np

from lfpipe.scene.analysis import AnalysedScene
from lfpipe.scene.lightfield import DisparitySource, LightField, Manifest
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


def scene_manifest(scene: AnalysedScene) -> Manifest:
    """The manifest of an analysed scene before it is packed, in display order. Offsets are rounded
    to keep a child's answer below 1 MB.
    """
    manifest = manifest_of(scene)
    manifest = attrs.evolve(
        manifest,
        method="",
        disparity=attrs.evolve(
            manifest.disparity,
            source=DisparitySource.UNKNOWN
            if scene.orientation.depth is None
            else DisparitySource.ESTIMATED,
        ),
        offsets=manifest.offsets and np.round(manifest.offsets, 3).tolist(),
    )
    return manifest.inverted() if scene.orientation.invert_depth else manifest


def facts(manifest: Manifest, pack: str = "") -> dict[str, Any]:
    """The facts of `lfpipe scene info --json`. pack: its folder, "" if there is none."""
    told = attrs.asdict(manifest)
    disparity = told["disparity"]
    low_px, high_px = disparity.pop("min_px"), disparity.pop("max_px")
    known = manifest.disparity.source is not DisparitySource.UNKNOWN
    return {
        **{name: told[name] for name in _NAMES},
        "orientation_evidence": told["orientation"],
        "disparity": {
            "min": low_px if known else None,
            "max": high_px if known else None,
            **disparity,
        },
        "views_missing": [
            [r, c]
            for r, line in enumerate(manifest.present)
            for c, is_present in enumerate(line)
            if not is_present
        ],
        "irregular": manifest.offsets is not None,
        "method": manifest.method or None,
        "scores_db": manifest.scores,
        "pack": pack or None,
        "pack_bytes": _size_bytes(pack),
    }


def _size_bytes(pack: str) -> int:
    return sum(file.stat().st_size for file in Path(pack).glob("*")) if pack else 0


def lines(manifest: Manifest, pack: str = "") -> list[str]:
    """The same facts for people."""
    order = manifest.orientation
    words = {
        "rows": "rows reversed",
        "cols": "columns reversed",
        "transpose": "rows and columns swapped",
    }
    turned = " and ".join(text for name, text in words.items() if getattr(manifest.flips, name))
    size = f"{manifest.rows}x{manifest.cols} views of {manifest.width}x{manifest.height} px"
    out = [f"{manifest.name}: {size}, layout {manifest.layout}"]

    def say(what: str, text: str) -> None:
        out.append(f"  {what:11} {text}")

    colour = "colour" if manifest.channels == 3 else "grey"
    tone = f", gamma {manifest.gamma:g} ({manifest.gamma_by})" if manifest.gamma != 1 else ""
    say("depth", f"{manifest.bit_depth} bit, {colour}{tone}")
    certainty = f"{order.by}, sure" if order.sure else order.by
    say("order", f"{turned or 'as in the files'}: {order.reason} ({certainty})")
    if order.undecided:
        say("undecided", f"{order.undecided}; `lfpipe scene describe` states what is right")
    if manifest.frames > 1:
        say("video", f"{manifest.frames} frames at {manifest.frame_rate_hz:g} Hz")
    about = manifest.disparity
    unmeasured = {
        DisparitySource.NONE: "none",
        DisparitySource.UNKNOWN: "measured when the scene is packed",
    }
    where = "" if pack else " from a few views"
    span = f"{about.min_px:+.2f} to {about.max_px:+.2f} px per view, {about.source}{where}"
    say("disparity", unmeasured.get(about.source, span))
    units = [
        f"{name.replace('_', ' ')} {value:g} {unit}"
        for key, value in attrs.asdict(manifest.geometry).items()
        for name, unit in [key.rsplit("_", 1)]
        if value
    ]
    say("geometry", ", ".join(units) or "not known")
    scores = ", ".join(f"{name} {value:.1f} dB" for name, value in manifest.scores.items())
    quality = f" (quality when predicting held-out views: {scores})" if scores else ""
    if manifest.method:
        say("method", f"{manifest.method}{quality}")
    for note in manifest.notes:
        say("note", note)
    say(
        "pack",
        f"{_size_bytes(pack) / 1e6:.1f} MB in {pack}"
        if pack
        else "none yet: `lfpipe scene pack` or `up` makes it",
    )
    return out


def expected_field(manifest: Manifest) -> LightField:
    """The expected pack of an unpacked scene: views and disparities are zeros that take no memory,
    and the method is that of most scenes.
    """
    warped = manifest.disparity.source is not DisparitySource.NONE
    return LightField.of(
        attrs.evolve(manifest, method="warp2" if warped else "nearest"),
        np.broadcast_to(np.uint8(0), manifest.views_shape),
        np.broadcast_to(np.int8(0), manifest.disparity_shape) if warped else None,
    )
