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
    """What `lfpipe scene info --json` prints. pack: its folder, "" if there is none."""
    return {**attrs.asdict(manifest), "pack": pack or None, "pack_bytes": _size_bytes(pack)}


def _size_bytes(pack: str) -> int:
    return sum(file.stat().st_size for file in Path(pack).glob("*")) if pack else 0


def lines(manifest: Manifest, pack: str = "") -> list[str]:
    """The facts for people."""
    order, about, flips = manifest.orientation, manifest.disparity, manifest.flips
    turned = ["rows reversed"] * flips.rows + ["columns reversed"] * flips.cols
    turned += ["rows and columns swapped"] * flips.transpose
    tone = f", gamma {manifest.gamma:g} ({manifest.gamma_by})" if manifest.gamma != 1 else ""
    sure = ", sure" if order.sure else ""
    where = "" if pack else " from a few views"
    units = [
        f"{name.replace('_', ' ')} {value:g} {unit}"
        for key, value in attrs.asdict(manifest.geometry).items()
        for name, unit in [key.rsplit("_", 1)]
        if value
    ]
    scores = ", ".join(f"{name} {value:.1f} dB" for name, value in manifest.scores.items())
    quality = f" (quality when predicting held-out views: {scores})" if scores else ""
    told = [
        (
            "depth",
            f"{manifest.bit_depth} bit, {'colour' if manifest.channels == 3 else 'grey'}{tone}",
        ),
        (
            "order",
            f"{' and '.join(turned) or 'as in the files'}: {order.reason} ({order.by}{sure})",
        ),
        (
            "undecided",
            order.undecided and f"{order.undecided}; `lfpipe scene describe` states what is right",
        ),
        (
            "video",
            f"{manifest.frames} frames at {manifest.frame_rate_hz:g} Hz" * (manifest.frames > 1),
        ),
        (
            "disparity",
            {
                DisparitySource.NONE: "none",
                DisparitySource.UNKNOWN: "measured when the scene is packed",
            }.get(
                about.source,
                f"{about.min_px:+.2f} to {about.max_px:+.2f} px per view, {about.source}{where}",
            ),
        ),
        ("geometry", ", ".join(units) or "not known"),
        ("method", manifest.method and f"{manifest.method}{quality}"),
        *(("note", note) for note in manifest.notes),
        (
            "pack",
            f"{_size_bytes(pack) / 1e6:.1f} MB in {pack}"
            if pack
            else "none yet: `lfpipe scene pack` or `up` makes it",
        ),
    ]
    size = f"{manifest.rows}x{manifest.cols} views of {manifest.width}x{manifest.height} px"
    head = f"{manifest.name}: {size}, layout {manifest.layout}"
    return [head, *(f"  {what:11} {text}" for what, text in told if text)]


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
