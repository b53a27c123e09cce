"""Compares a run with a reference: the first difference, its cause, and pictures that show it.

With the same versions on the same kind of processor, everything must be equal to the last bit.
Otherwise, numbers may differ by the effect of different rounding (TOLERANCES), and pictures by
invisible amounts (MIN_DB).
"""

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.config import Config, options
from lfpipe.config.check import MAX_LISTED, flat
from lfpipe.errors import VALUE_CHARS, UserError, plain, quoted
from lfpipe.files.pictures import header_of
from lfpipe.files.safe_files import write_output
from lfpipe.render.listeners import PICTURES
from lfpipe.replays.run import (
    COUNTED,
    DIFFERENCE,
    Line,
    Report,
    pair,
    read_report,
    read_trace,
    writing,
)
from lfpipe.sequence.packets import INDEX, Packets, decoded, encoded, read_index, read_packet

# name in the trace -> px or views, where versions differ: between x86-64 and ARM, eyes differed by
# 0.02 px in the median and by at most 0.08
TOLERANCES = {"eyes_raw": 0.1, "eyes_filtered": 0.1, "eyes_used": 0.1, "view": 0.01}
MIN_DB = 50.0  # 0.8 levels root mean square: nobody sees that
# of a scene; its name is that of a folder, which may be renamed
SHAPE = ("frames", "rows", "cols", "height_px", "width_px")
CAUSES = {  # in the order of the pipeline: an earlier difference causes the later ones
    "face": (
        "tracking finds a face in other frames (lfpipe/track: engine, detector, choice of the face)"
    ),
    "eyes_raw": (
        "the engine measures other eyes in the same frame (lfpipe/track: engine, region of"
        " interest, landmarks)"
    ),
    "eyes_filtered": (
        "raw eyes are equal: the filter or its constants changed (track.filter,"
        " lfpipe/track/filters/)"
    ),
    "eyes_used": (
        "filtered eyes are equal: prediction or easing changed (replay.latency_ms, lfpipe/eyes.py,"
        " lfpipe/render)"
    ),
    "view": (
        "eyes are equal: the map to views changed (alpha, centre,"
        " render/synthesis/viewpoint.py, render/viewer/geometry.py)"
    ),
    "method": "another way of making views was chosen (render.method, the scene's scores)",
    "picture": (
        "views are equal: the drawing changed (anaglyph coefficients, synthesis, or the scene's"
        " pictures and their order)"
    ),
}


@attrs.frozen
class Difference:
    """The first difference of a kind."""

    part: str
    """One of PARTS."""
    what: str
    frame: int | None = None
    """source_seq of the first one, None for the whole run."""

    def __str__(self) -> str:
        return (
            f"{self.part}: {self.what}"
            if self.frame is None
            else f"{self.part}: frame {self.frame}: {self.what}"
        )


@attrs.frozen
class ComparedFrame:
    """Lines of a frame in the reference and now."""

    was: Line
    now: Line
    cause: str
    """Name of their first difference in CAUSES, or "" for none."""


@attrs.frozen
class Comparison:
    """The result of a comparison."""

    differences: list[Difference]
    """Empty if everything matches."""
    notes: list[str]
    """How the comparison was made, for people."""


PARTS = ("config", "plan", "scene", "counts", "eyes", "views", "pictures")
_PART_OF = {
    **dict.fromkeys(("face", *TOLERANCES), "eyes"),
    "view": "views",
    "method": "views",
}


def cases_of(differences: list[Difference]) -> list[tuple[str, list[str]]]:
    """(test case, its failures) of a comparison."""
    return [
        (part, [str(difference) for difference in differences if difference.part == part])
        for part in PARTS
    ]


def check_reference(reference: Path, report: Report) -> None:
    """Raises UserError if reference has another sequence or scene than report: a comparison would
    be meaningless.
    """
    was = read_report(reference)
    remedy = "use its own reference, or create one with --update"
    for part, names in (("sequence", ("frames", "checksums")), ("scene", SHAPE)):
        for name in names:
            before = was[part].get(name)
            now = report[part][name]
            if before != now:
                values = (
                    ""
                    if isinstance(now, dict)
                    else f": {name} {quoted(before)} in the reference, {quoted(now)} now"
                )
                raise UserError(f"{reference}: was made with another {part}{values}", remedy)


def compare(reference: Path, folder: Path, keeps: bool = True) -> Comparison:
    """Compares the reference with the run in folder, which `check_reference` allows. keeps: save
    the pictures that show differences to folder/difference, and name them.

    Raises UserError if the reference cannot be read.
    """
    was, now = read_report(reference), read_report(folder)
    theirs, ours = was["versions"], now["versions"]
    others = ", ".join(
        f"{name} {plain(str(theirs[name]), VALUE_CHARS)} in the reference, {ours[name]} now"
        for name in sorted(theirs.keys() & ours.keys())
        if theirs[name] != ours[name]
    )
    # why tolerances are used; without another version, all must be equal to the last bit
    versions = f"compared with tolerances, not bit for bit: {others}" if others else ""
    # a key that one of them does not know had its default's effect
    before, after = (
        dict(flat(attrs.asdict(Config()))) | dict(flat(report["config"])) for report in (was, now)
    )
    compared = [name for name, key in options().items() if key.replays]
    differences = _unequal(
        "config", *({name: settings[name] for name in compared} for settings in (before, after))
    )
    differences += _unequal("plan", was["plan"], now["plan"])
    if was["scene"].get("views") != now["scene"]["views"]:
        differences.append(Difference("scene", "the pictures of its views differ"))
    elif was["scene"].get("order") != now["scene"]["order"]:
        differences.append(Difference("scene", "the same views in another order"))
    differences += _unequal(
        "counts", *({key: report["counts"][key] for key in COUNTED} for report in (was, now))
    )
    lines_now = read_trace(folder)
    pictures = min(was["counts"]["pictures"], now["sequence"]["frames"])  # one per frame, at most
    lines_before = read_trace(reference, most_lines=pictures + 1)
    if len(lines_before) != was["counts"]["pictures"]:
        values = (
            f"its trace has {len(lines_before)} lines, its report {was['counts']['pictures']}"
            " pictures"
        )
        raise UserError(
            f"{reference}: {values}", "copy the whole folder again, or rewrite it with --update"
        )
    in_frames, notes = _compare_frames(
        reference, folder, zip(lines_before, lines_now, strict=False), bool(versions), keeps
    )
    return Comparison(differences + in_frames, ([versions] if versions else []) + notes)


def _unequal(part: str, was: dict[str, Any], now: dict[str, Any]) -> list[Difference]:
    keys = [key for key in sorted(was | now) if was.get(key) != now.get(key)]
    texts = [
        f"{key[:80]}: {quoted(was.get(key))} in the reference, {quoted(now.get(key))} now"
        for key in keys[:MAX_LISTED]
    ]
    texts += [f"and {len(keys) - MAX_LISTED} more keys"] if len(keys) > MAX_LISTED else []
    return [Difference(part, text) for text in texts]


def _first_difference(was: Line, now: Line, tolerant: bool) -> str:
    """The first name of CAUSES whose values differ by more than rounding, "" for none."""
    for name in CAUSES:
        if was.get(name) == now.get(name):
            continue
        if not (tolerant and name in TOLERANCES):
            return name
        apart = np.subtract(pair(was, name), pair(now, name))
        if not np.abs(apart).max() <= TOLERANCES[name]:
            return name
    return ""


def _compare_frames(
    reference: Path,
    folder: Path,
    lines: Iterable[tuple[Line, Line]],
    tolerant: bool,
    keeps: bool,
) -> tuple[list[Difference], list[str]]:
    """The first difference of each part, frame by frame, and notes.

    lines: those of each frame, the reference's first.
    """
    frames = [ComparedFrame(was, now, _first_difference(was, now, tolerant)) for was, now in lines]
    differences = list[Difference]()
    for part in ("eyes", "views"):
        if changed := [frame for frame in frames if _PART_OF.get(frame.cause) == part]:
            first = changed[0]
            name = first.cause
            what = (
                f"{name} {_sides(first.was.get(name))} in the reference,"
                f" {_sides(first.now.get(name))} now{_apart(first)};"
                f" {CAUSES[name]}; {len(changed)} of {len(frames)} frames"
            )
            differences.append(Difference(part, what, first.now["source_seq"]))
    pictures, notes = _compare_pictures(reference, folder, frames, not tolerant, keeps)
    return differences + pictures, notes


def _sides(value: Any) -> str:
    if not isinstance(value, dict):
        return repr(value)
    return " ".join(f"{side} {value[side][0]:.2f}, {value[side][1]:.2f}" for side in value)


def _apart(frame: ComparedFrame) -> str:
    """By how much eyes or views differ, "" for anything else."""
    if frame.cause not in TOLERANCES:
        return ""
    apart = np.abs(np.subtract(pair(frame.was, frame.cause), pair(frame.now, frame.cause))).max()
    return f", up to {apart:.2g} apart"


def _stored(folder: Path, lines: list[Line]) -> Callable[[str], NDArray[np.uint8] | None]:
    """Reads the pictures that a run stored, by digest.

    Equal digests mean equal pictures, whatever the frame.
    """
    place = folder / PICTURES
    digest_of = {line["source_seq"]: line["picture"] for line in lines}
    packets = read_index(place) if os.path.lexists(place / INDEX) else Packets()
    by_digest = {
        digest_of[packet.source_seq]: packet for packet in packets if packet.source_seq in digest_of
    }

    def read(digest: str) -> NDArray[np.uint8] | None:
        if (packet := by_digest.get(digest)) is None:
            return None
        data = read_packet(place, packet)
        header = header_of(data)
        return decoded(
            packet, data, header.width_px if header else 0, header.height_px if header else 0, place
        )

    return read


def _compare_pictures(
    reference: Path, folder: Path, frames: list[ComparedFrame], exact: bool, keeps: bool
) -> tuple[list[Difference], list[str]]:
    """Differences of pictures with equal views, and the pictures of the first frame that differs in
    anything; a note.
    """
    theirs = _stored(reference, [frame.was for frame in frames])
    ours = _stored(folder, [frame.now for frame in frames])
    unequal = [
        (frame.was, frame.now) for frame in frames if frame.was["picture"] != frame.now["picture"]
    ]
    drawn = [(frame.was, frame.now) for frame in frames if frame.cause == "picture"]
    first = None
    least_db = 100.0
    for was, now in unequal:
        a = theirs(was["picture"])
        b = ours(now["picture"])
        if a is not None and b is not None:
            first = first or (now["source_seq"], a, b)
            least_db = min(least_db, cv2.PSNR(a, b) if a.shape == b.shape else 0.0)
    wrong = bool(drawn) and (exact or first is None or least_db < MIN_DB)
    if not wrong and len(unequal) == len(drawn):
        note = (
            f"pictures: {len(drawn)} of {len(frames)} digests differ, least PSNR {least_db:.1f} dB"
            f" ({MIN_DB:g} wanted)"
        )
        return [], [note] if drawn else []
    where = f"least PSNR {least_db:.1f} dB" if first else "no frame has a stored picture in both"
    if first and keeps:
        where += f", see {_save(folder, *first)}"
    was, now = drawn[0] if wrong else unequal[0]
    what = f"{len(unequal)} of {len(frames)} differ, as a result of the differences above"
    if wrong:
        digests = f"digest {was['picture']} in the reference, {now['picture']} now"
        what = f"{digests}; {CAUSES['picture']}; {len(drawn)} of {len(frames)} frames"
    return [Difference("pictures", f"{what}; {where}", now["source_seq"])], []


def _save(folder: Path, frame: int, was: NDArray[np.uint8], now: NDArray[np.uint8]) -> str:
    """Saves both pictures and their difference (scaled so that the largest is white).

    Returns their folder.
    """
    out = folder / DIFFERENCE
    sides = {"reference": was, "now": now}
    if was.shape == now.shape:
        difference = cv2.absdiff(was, now)
        sides["difference"] = np.asarray(
            cv2.convertScaleAbs(difference, alpha=255 / max(1, int(difference.max()))), np.uint8
        )
    with writing(out):
        out.mkdir(exist_ok=True)
        for name, picture in sides.items():
            write_output(out / f"frame_{frame:06d}_{name}.png", encoded(picture))
    return f"{out}/frame_{frame:06d}_*.png"
