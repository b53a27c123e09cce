"""Facts about a scene, for people and programs: from its pack, or from an examination if there is none yet."""

from pathlib import Path
from typing import Any

import attrs

from lfpipe.errors import plain
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.packing import Examined

_NAMES = ("layout", "rows", "cols", "height", "width", "channels", "bit_depth", "frames", "frame_rate_hz", "flips")


def describe_pack(field: LightField) -> dict[str, Any]:
    """The facts of `lfpipe scene info --json`."""
    manifest = field.manifest
    missing = [[r, c] for r in range(field.rows) for c in range(field.cols) if not field.present[r, c]]
    about = dict(manifest["disparity"])
    low, high, source = about.pop("min_px"), about.pop("max_px"), about.pop("source")
    return {
        "name": field.name,
        "source": manifest["source"],
        **{name: manifest[name] for name in _NAMES},
        "orientation_evidence": manifest["orientation"],
        "disparity": {"min": low, "max": high, "source": source, **about},
        "geometry": manifest["geometry"],
        "views_missing": missing,
        "gamma": manifest["gamma"],
        "gamma_by": manifest["gamma_by"],
        "method": field.method,
        "scores_db": manifest["scores"],
        "irregular": manifest["offsets"] is not None,
        "notes": manifest["notes"],
        "pack": field.folder,
        "pack_bytes": sum(file.stat().st_size for file in Path(field.folder).glob("*")),
    }


def describe_examined(examined: Examined) -> dict[str, Any]:
    """The facts of an unpacked scene, with the keys of `describe_pack`: facts that need packing are None or empty."""
    source, orientation = examined.source, examined.orientation
    rows, cols = orientation.turn.grid(source.rows, source.cols)
    missing = {(r, c) for r in range(rows) for c in range(cols)
               if orientation.turn.file_index(r, c, rows, cols) in source.missing}  # fmt: skip
    low, high = orientation.disparity_px or (None, None)
    path = source.path.resolve()
    return {
        "name": plain(path.stem if path.is_file() else path.name, 300), "source": plain(str(path), 10_000),
        "layout": source.layout, "rows": rows, "cols": cols, "height": source.height_px, "width": source.width_px,
        "channels": examined.channels, "bit_depth": source.bit_depth, "frames": source.frames,
        "frame_rate_hz": source.frame_rate_hz, "flips": attrs.asdict(orientation.turn),
        "orientation_evidence": orientation.facts(cols),
        "disparity": {"min": low, "max": high, "source": "unknown" if low is None else "estimated"},
        "geometry": attrs.asdict(source.geometry), "views_missing": [list(index) for index in sorted(missing)],
        "gamma": examined.gamma, "gamma_by": examined.gamma_by, "method": None, "scores_db": {},
        "irregular": source.coordinates is not None, "notes": list(source.notes), "pack": None, "pack_bytes": 0,
    }  # fmt: skip


def lines(facts: dict[str, Any]) -> list[str]:
    """The same facts for people."""
    found = facts["orientation_evidence"]
    turned = [name for name, on in (("rows reversed", facts["flips"]["rows"]), ("columns reversed", facts["flips"]["cols"]),
                                    ("rows and columns exchanged", facts["flips"]["transpose"])) if on]  # fmt: skip
    disparity, geometry = facts["disparity"], facts["geometry"]
    by = f"{found['by']}{', sure' if found['sure'] else ''}"
    tone = f", gamma {facts['gamma']:g} ({facts['gamma_by']})" if facts["gamma"] != 1 else ""
    out = [
        f"{facts['name']}: {facts['rows']}x{facts['cols']} views of {facts['width']}x{facts['height']} px, "
        f"layout {facts['layout']}",
        f"  depth       {facts['bit_depth']} bit, {'colour' if facts['channels'] == 3 else 'grey'}{tone}",
        f"  order       {' and '.join(turned) or 'as in the files'}: {found['said']} ({by})",
    ]
    if found["undecided"]:
        out.append(f"  undecided   {found['undecided']}")
    if facts["frames"] > 1:
        out.append(f"  video       {facts['frames']} frames at {facts['frame_rate_hz']:g} Hz")
    if disparity["source"] == "unknown":
        out.append("  disparity   measured when the scene is packed")
    elif disparity["source"] == "none":
        out.append("  disparity   none")
    else:
        check = disparity.get("median_error_px")
        where = "" if facts["pack"] else " from a few views"
        out.append(f"  disparity   {disparity['min']:+.2f} to {disparity['max']:+.2f} px per view, {disparity['source']}{where}"
                   + (f"; maps from flow, {check:.2f} px off the truth in the median" if check is not None else ""))  # fmt: skip
    parts = [(*name.rsplit("_", 1), value) for name, value in geometry.items() if value]
    known = [f"{name.replace('_', ' ')} {value:g} {unit}" for name, unit, value in parts]
    out.append(f"  geometry    {', '.join(known) or 'not known'}")
    scores = ", ".join(f"{name} {value:.1f} dB" for name, value in facts["scores_db"].items())
    if facts["method"]:
        out.append(
            f"  method      {facts['method']}" + (f" (quality when predicting held-out views: {scores})" if scores else "")
        )
    out += [f"  note        {note}" for note in facts["notes"]]
    out.append(f"  pack        {facts['pack_bytes'] / 1e6:.1f} MB in {facts['pack']}" if facts["pack"] else
               "  pack        none yet: `lfpipe scene pack` or `up` makes it")  # fmt: skip
    return out
