"""Compares a run with a reference: the first difference, its cause, and pictures that show it.

With the same versions on the same kind of processor, everything must be equal to the last bit. Otherwise, numbers may differ by
the effect of different rounding (TOLERANCES), and pictures by invisible amounts (LEAST_DB).
"""

import os
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.errors import UserError, shown
from lfpipe.files.output import PLACE, marked_picture, write_output
from lfpipe.files.picture_header import header_of
from lfpipe.files.safe_files import open_regular, reason
from lfpipe.host.descriptors import read_at
from lfpipe.render.replay_writer import PICTURES
from lfpipe.render.scoring import psnr_db
from lfpipe.replays.report import REPORT, WRITTEN, Line, pair, read_report, read_trace
from lfpipe.sequence.index import INDEX, Packet, read_index
from lfpipe.sequence.index import PACKETS as PACKET_FILE
from lfpipe.sequence.packets import decoded, encoded

TOLERANCES = {  # name in the trace -> (absolute, relative), where versions differ
    "eyes_raw": (0.05, 1e-4),
    "eyes_filtered": (0.05, 1e-4),
    "eyes_used": (0.05, 1e-4),
    "view": (0.01, 0.0),  # whole numbers, of method nearest, must then be equal
}
LEAST_DB = 50.0
MOST_FIELDS = 20  # listed per part
CAUSES = {  # in the order of the pipeline: an earlier difference causes the later ones
    "face": "tracking finds a face in other frames (lfpipe/track: engine, detector, choice of the face)",
    "eyes_raw": "the engine measures other eyes in the same frame (lfpipe/track: engine, region of interest, landmarks)",
    "eyes_filtered": "raw eyes are equal: the filter or its constants changed (track.filter, lfpipe/track/filters.py)",
    "eyes_used": "filtered eyes are equal: prediction or easing changed (replay.latency_ms, lfpipe/eyes.py, lfpipe/render)",
    "view": "eyes are equal: the map to views changed (alpha, centre, lfpipe/render/viewpoint.py, geometry.py)",
    "method": "another way of making views was chosen (render.method, the scene's scores)",
    "picture": "views are equal: the drawing changed (anaglyph coefficients, synthesis, or the scene's pictures and their order)",
}
OF_NO_EFFECT = (
    "control.",
    "camera.source",
    "camera.format",
    "scene.cache_dir",
    "render.clock",
    "render.rate_hz",
    "render.loop_",
    "governor.",
    "observe.",
    "screen.monitor",
)


@attrs.frozen
class Difference:
    """part: config, plan, counts, scene, eyes, views or pictures. frame: source_seq of the first one, None for the whole run."""

    part: str
    what: str
    frame: int | None = None

    def __str__(self) -> str:
        return f"{self.part}: {self.what}" if self.frame is None else f"{self.part}: frame {self.frame}: {self.what}"


@attrs.frozen
class Comparison:
    """differences: empty if everything matches. notes: how the comparison was made, for people."""

    differences: list[Difference]
    notes: list[str]


PARTS = ("config", "plan", "scene", "counts", "eyes", "views", "pictures")
_PART_OF = {"face": "eyes", "view": "views", "method": "views", "picture": "pictures"}


def check_reference(reference: Path, report: dict[str, Any]) -> None:
    """Raises UserError if reference has another sequence or scene than report: a comparison would be meaningless."""
    was = read_report(reference)
    remedy = "use the reference that belongs to it, or --update to make one"
    shape = ("name", "frames", "rows", "cols", "height_px", "width_px")
    for part, names in (("sequence", ("frames", "checksums")), ("scene", shape)):
        for name in names:
            if was[part][name] != report[part][name]:
                before, now = was[part][name], report[part][name]
                told = "" if isinstance(now, dict) else f": {name} {shown(before)} in the reference, {shown(now)} now"
                raise UserError(f"{reference}: made with another {part}{told}", remedy)
    if was["counts"]["pictures"] > was["sequence"]["frames"]:
        told = f"{was['counts']['pictures']} pictures of {was['sequence']['frames']} frames"
        raise UserError(f"{reference / REPORT}: {told}, expected one per frame", remedy)


def _flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in tree.items():
        found |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return found


def _fields(part: str, was: dict[str, Any], now: dict[str, Any], skipped: tuple[str, ...] = ()) -> list[Difference]:
    before, after = _flat(was), _flat(now)
    keys = [key for key in sorted(before | after) if not key.startswith(skipped)] if skipped else sorted(before | after)
    apart = [key for key in keys if before.get(key) != after.get(key)]
    found = [f"{key[:80]}: {shown(before.get(key))} in the reference, {shown(after.get(key))} now" for key in apart[:MOST_FIELDS]]
    more = [f"and {len(apart) - MOST_FIELDS} more keys"] if len(apart) > MOST_FIELDS else []
    return [Difference(part, what) for what in found + more]


def _equal(name: str, was: Line, now: Line, exact: bool) -> bool:
    if name not in TOLERANCES:
        return bool(was[name] == now[name])
    a, b = np.array(pair(was, name)), np.array(pair(now, name))
    if exact or (name == "view" and now["method"] == "nearest"):
        return bool(np.array_equal(a, b))
    absolute, relative = TOLERANCES[name]
    return bool(np.all(np.abs(a - b) <= np.maximum(absolute, relative * np.maximum(np.abs(a), np.abs(b)))))


class _Pictures:
    """The pictures that a run stored, by digest. Equal digests mean equal pictures, whatever the frame."""

    def __init__(self, folder: Path, lines: list[Line]) -> None:
        self._folder = folder / PICTURES
        by_seq = {line["source_seq"]: line["picture"] for line in lines}
        packets = read_index(self._folder, complete=True) if os.path.lexists(self._folder / INDEX) else ()
        self._kept: dict[str, Packet] = {by_seq[p.source_seq]: p for p in packets if p.source_seq in by_seq}

    def get(self, digest: str) -> NDArray[np.uint8] | None:
        """Raises UserError if the stored picture is damaged."""
        packet = self._kept.get(digest)
        if packet is None:
            return None
        path = self._folder / PACKET_FILE
        try:
            with open_regular(path) as file:
                data = read_at(file.fileno(), packet.bytes, packet.offset)
        except OSError as error:
            raise UserError(f"{path}: cannot be read: {reason(error)}", WRITTEN) from None
        header = header_of(data)
        return decoded(packet, data, header.width_px if header else 0, header.height_px if header else 0, self._folder)


def likeness_db(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Peak signal-to-noise ratio of two 8-bit pictures; 0 for pictures of different size, 100 for equal ones."""
    if a.shape != b.shape:
        return 0.0
    return psnr_db(float(np.mean(np.square(a.astype(np.float32) - b.astype(np.float32)), dtype=np.float64)))


def _save(folder: Path, frame: int, was: NDArray[np.uint8], now: NDArray[np.uint8]) -> str:
    """Saves both pictures and their difference (scaled so that the largest is white). Returns their folder."""
    out = folder / "difference"
    sides = {"reference": was, "now": now}
    if was.shape == now.shape:
        apart = cv2.absdiff(was, now)
        sides["difference"] = np.asarray(cv2.convertScaleAbs(apart, alpha=255 / max(1, int(apart.max()))), np.uint8)
    try:
        out.mkdir(exist_ok=True)
        for name, picture in sides.items():
            write_output(out / f"frame_{frame:06d}_{name}.png", marked_picture(encoded(picture, fast=False)[1]))
    except OSError as error:
        raise UserError(f"{out}: {reason(error)}", PLACE) from None
    return f"{out}/frame_{frame:06d}_*.png"


def compare(reference: Path, folder: Path) -> Comparison:
    """Compares the reference with the run in folder. Saves the pictures that show differences to folder/difference.

    Raises UserError if the reference cannot be read or has another sequence or scene.
    """
    was, now = read_report(reference), read_report(folder)
    check_reference(reference, now)
    exact = was["versions"] == now["versions"]
    found = _fields("config", was["config"], now["config"], OF_NO_EFFECT)
    found += _fields("plan", was["plan"], now["plan"])
    if was["scene"] != now["scene"]:
        same_views = was["scene"]["views"] == now["scene"]["views"]
        found.append(Difference("scene", "the same views in another order" if same_views else "the pictures of its views differ"))
    counted = ("frames", "pictures", "faces")
    a, b = ({key: report["counts"][key] for key in counted} for report in (was, now))
    found += _fields("counts", a, b)
    before, after = read_trace(reference, most_lines=was["counts"]["pictures"]), read_trace(folder)
    if len(before) != was["counts"]["pictures"]:
        told = f"{len(before)} lines in its trace, {was['counts']['pictures']} pictures in its report"
        raise UserError(f"{reference}: {told}", "copy the whole folder again, or --update to rewrite it")
    in_frames, notes = _frames(reference, folder, before, after, exact)
    if not exact:
        notes.insert(0, f"compared with tolerances, not bit by bit: {_other_versions(was['versions'], now['versions'])}")
    return Comparison(found + in_frames, notes)


def _other_versions(was: dict[str, str], now: dict[str, str]) -> str:
    names = [name for name in sorted(was | now) if was.get(name) != now.get(name)]
    return ", ".join(f"{name} {was.get(name)} in the reference, {now.get(name)} now" for name in names)


def _frames(
    reference: Path, folder: Path, before: list[Line], after: list[Line], exact: bool
) -> tuple[list[Difference], list[str]]:
    """The first difference of each part, frame by frame, and notes."""
    first: dict[str, tuple[int, str, Line, Line]] = {}
    counts: dict[str, int] = {}
    drawn: list[tuple[Line, Line]] = []
    for was, now in zip(before, after, strict=False):
        for name in CAUSES:
            if _equal(name, was, now, exact):
                continue
            if name == "picture":
                drawn.append((was, now))
                continue
            part = _PART_OF.get(name, "eyes")
            first.setdefault(part, (now["source_seq"], name, was, now))
            counts[part] = counts.get(part, 0) + 1
            break  # later differences in this frame result from it
    found = []
    for part, (frame, name, was, now) in first.items():
        values = f"{name} {_told(was[name])} in the reference, {_told(now[name])} now"
        what = f"{values}; {CAUSES[name]}; {counts[part]} of {len(after)} frames"
        found.append(Difference(part, what, frame))
    pictures, notes = _drawn(reference, folder, before, after, drawn, exact)
    return found + pictures, notes


def _told(value: Any) -> str:
    return f"left {value['left']} right {value['right']}" if isinstance(value, dict) else repr(value)


def _drawn(
    reference: Path, folder: Path, before: list[Line], after: list[Line], drawn: list[tuple[Line, Line]], exact: bool
) -> tuple[list[Difference], list[str]]:
    """Differences of pictures with equal views, and the pictures of the first frame that differs in anything; notes."""
    ours, theirs = _Pictures(folder, after), _Pictures(reference, before)
    pairs = [(was, now) for was, now in zip(before, after, strict=False) if was["picture"] != now["picture"]]
    first: tuple[int, NDArray[np.uint8], NDArray[np.uint8]] | None = None
    least_db = 100.0
    for was, now in pairs:
        a, b = theirs.get(was["picture"]), ours.get(now["picture"])
        if a is not None and b is not None:
            first = first or (now["source_seq"], a, b)
            least_db = min(least_db, likeness_db(a, b))
    wrong = bool(drawn) and (exact or first is None or least_db < LEAST_DB)
    if not wrong and len(pairs) == len(drawn):
        told = f"pictures: {len(drawn)} of {len(after)} digests differ, least PSNR {least_db:.1f} dB ({LEAST_DB:g} wanted)"
        return [], [told] if drawn else []
    where = f"least PSNR {least_db:.1f} dB, see {_save(folder, *first)}" if first else "no frame has a stored picture in both"
    if wrong:
        was, now = drawn[0]
        what = f"digest {was['picture']} in the reference, {now['picture']} now; {CAUSES['picture']}"
        return [Difference("pictures", f"{what}; {len(drawn)} of {len(after)} frames; {where}", now["source_seq"])], []
    what = f"{len(pairs)} of {len(after)} differ, as a result of the differences above; {where}"
    return [Difference("pictures", what, pairs[0][1]["source_seq"])], []
