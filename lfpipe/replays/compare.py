"""Compares a run with a reference: the first difference, its cause, and pictures that show it.

With the same versions on the same kind of processor, everything must be equal to the last bit. Otherwise, numbers may differ by
the effect of different rounding (TOLERANCES; between x86 and ARM networks round more, MACHINE_PX), a whole view may flip where
the eyes are within that of its boundary, and pictures may differ by invisible amounts (LEAST_DB).
"""

import os
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config, options, to_dict
from lfpipe.errors import UserError, shown
from lfpipe.files.output import PLACE, marked_picture, write_output
from lfpipe.files.pictures import header_of
from lfpipe.files.safe_files import reason
from lfpipe.render.replay_writer import PICTURES
from lfpipe.render.scoring import psnr_db
from lfpipe.replays.report import REPORT, WRITTEN, Line, pair, read_report, read_trace
from lfpipe.sequence.packets import INDEX, Packet, decoded, encoded, packet_data, read_index

VERSION_PX = 0.05  # of eyes
TOLERANCES = {  # name in the trace -> (absolute, relative), where versions differ
    "eyes_raw": (VERSION_PX, 1e-4),
    "eyes_filtered": (VERSION_PX, 1e-4),
    "eyes_used": (VERSION_PX, 1e-4),
    "view": (0.01, 0.0),  # 1/5 of a px at the smallest alpha in use
}
MACHINE_PX = 0.1  # between x86-64 and ARM: 0.02 median, 0.08 at most were measured
FLIPPED_SHARE = 0.05  # of frames: eyes uncertain by 0.1 px are near a boundary of views 4 px wide; more is another map
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


def cases_of(compared: bool, differences: list[Difference]) -> list[tuple[str, list[str]]]:
    """(test case, its failures) of a finished replay; none without a comparison."""
    return [(part, [str(each) for each in differences if each.part == part]) for part in PARTS] if compared else []


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


def _equal(name: str, was: Line, now: Line, eyes_px: float) -> bool:
    """Whether an entry of two lines agrees. eyes_px: tolerance of eyes, 0 for the last bit."""
    if name not in TOLERANCES:
        return bool(was[name] == now[name])
    a, b = np.array(pair(was, name)), np.array(pair(now, name))
    if not eyes_px or (name == "view" and now["method"] == "nearest"):
        return bool(np.array_equal(a, b))
    absolute, relative = TOLERANCES[name]
    absolute *= eyes_px / VERSION_PX
    return bool(np.all(np.abs(a - b) <= np.maximum(absolute, relative * np.maximum(np.abs(a), np.abs(b)))))


def _flipped(was: Line, now: Line) -> bool:
    """Whether whole views are neighbours and the eyes differ a little: they may be on both sides of a boundary."""
    apart = np.abs(np.subtract(pair(was, "view"), pair(now, "view")))
    return bool(now["method"] == "nearest" and apart.max() <= 1 and pair(was, "eyes_used") != pair(now, "eyes_used"))


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
        data = packet_data(self._folder, packet, WRITTEN)
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
    eyes_px = _tolerance_px(was["versions"], now["versions"])
    # a key that one of them does not know had its default's effect
    before, after = (_flat(to_dict(Config())) | _flat(report["config"]) for report in (was, now))
    known = {name: key.replays for name, key in options().items()}
    of_no_effect = tuple(key for key in before | after if not known.get(key))  # a key that is gone has none
    found = _fields("config", before, after, of_no_effect)
    found += _fields("plan", was["plan"], now["plan"])
    if was["scene"] != now["scene"]:
        same_views = was["scene"]["views"] == now["scene"]["views"]
        found.append(Difference("scene", "the same views in another order" if same_views else "the pictures of its views differ"))
    counted = ("frames", "pictures", "faces")
    a, b = ({key: report["counts"][key] for key in counted} for report in (was, now))
    found += _fields("counts", a, b)
    lines_before, lines_now = read_trace(reference, most_lines=was["counts"]["pictures"]), read_trace(folder)
    if len(lines_before) != was["counts"]["pictures"]:
        told = f"{len(lines_before)} lines in its trace, {was['counts']['pictures']} pictures in its report"
        raise UserError(f"{reference}: {told}", "copy the whole folder again, or --update to rewrite it")
    in_frames, notes = _frames(reference, folder, lines_before, lines_now, eyes_px)
    if eyes_px:
        notes.insert(0, f"compared with tolerances, not bit by bit: {_other_versions(was['versions'], now['versions'])}")
    return Comparison(found + in_frames, notes)


def _kind(versions: dict[str, str]) -> str:
    """The kind of processor; older references name it only where its model is unknown."""
    return versions.get("machine", "x86_64").lower().replace("arm64", "aarch64").replace("amd64", "x86_64")


def _tolerance_px(was: dict[str, str], now: dict[str, str]) -> float:
    if _kind(was) != _kind(now):
        return MACHINE_PX
    return VERSION_PX if any(was[name] != now[name] for name in was.keys() & now.keys()) else 0.0


def _other_versions(was: dict[str, str], now: dict[str, str]) -> str:
    names = [name for name in sorted(was.keys() & now.keys()) if was[name] != now[name]]
    if _kind(was) != _kind(now) and "machine" not in names:
        return f"{_kind(was)} in the reference, {_kind(now)} now; {_other_versions(was, {**now, 'machine': _kind(was)})}"
    return ", ".join(f"{name} {was.get(name)} in the reference, {now.get(name)} now" for name in names)


def _frames(
    reference: Path, folder: Path, before: list[Line], after: list[Line], eyes_px: float
) -> tuple[list[Difference], list[str]]:
    """The first difference of each part, frame by frame, and notes."""
    flipped = {
        now["source_seq"]
        for was, now in zip(before, after, strict=False)
        if eyes_px and not _equal("view", was, now, eyes_px) and _flipped(was, now)
    }
    if len(flipped) > FLIPPED_SHARE * len(after):
        flipped = set()
    first: dict[str, tuple[int, str, Line, Line]] = {}
    counts: dict[str, int] = {}
    drawn: list[tuple[Line, Line]] = []
    for was, now in zip(before, after, strict=False):
        for name in CAUSES:
            if _equal(name, was, now, eyes_px):
                continue
            if name == "view" and now["source_seq"] in flipped:
                break  # its picture is another one, too
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
    same_views = [(was, now) for was, now in zip(before, after, strict=False) if now["source_seq"] not in flipped]
    pictures, notes = _drawn(reference, folder, same_views, drawn, not eyes_px)
    if flipped:
        notes.append(f"views: {len(flipped)} of {len(after)} flipped, with eyes within {eyes_px:g} px of a boundary")
    return found + pictures, notes


def _told(value: Any) -> str:
    return f"left {value['left']} right {value['right']}" if isinstance(value, dict) else repr(value)


def _drawn(
    reference: Path, folder: Path, lines: list[tuple[Line, Line]], drawn: list[tuple[Line, Line]], exact: bool
) -> tuple[list[Difference], list[str]]:
    """Differences of pictures with equal views, and the pictures of the first frame that differs in anything; notes.
    lines: (reference, now) of each frame."""
    theirs, ours = (_Pictures(place, [line[k] for line in lines]) for k, place in enumerate((reference, folder)))
    pairs = [(was, now) for was, now in lines if was["picture"] != now["picture"]]
    first: tuple[int, NDArray[np.uint8], NDArray[np.uint8]] | None = None
    least_db = 100.0
    for was, now in pairs:
        a, b = theirs.get(was["picture"]), ours.get(now["picture"])
        if a is not None and b is not None:
            first = first or (now["source_seq"], a, b)
            least_db = min(least_db, likeness_db(a, b))
    wrong = bool(drawn) and (exact or first is None or least_db < LEAST_DB)
    if not wrong and len(pairs) == len(drawn):
        told = f"pictures: {len(drawn)} of {len(lines)} digests differ, least PSNR {least_db:.1f} dB ({LEAST_DB:g} wanted)"
        return [], [told] if drawn else []
    where = f"least PSNR {least_db:.1f} dB, see {_save(folder, *first)}" if first else "no frame has a stored picture in both"
    if wrong:
        was, now = drawn[0]
        what = f"digest {was['picture']} in the reference, {now['picture']} now; {CAUSES['picture']}"
        return [Difference("pictures", f"{what}; {len(drawn)} of {len(lines)} frames; {where}", now["source_seq"])], []
    what = f"{len(pairs)} of {len(lines)} differ, as a result of the differences above; {where}"
    return [Difference("pictures", what, pairs[0][1]["source_seq"])], []
