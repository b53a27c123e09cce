"""`lfpipe sequence`: look at recorded sequences, cut them, turn videos into them and them into videos."""

from __future__ import annotations

import json
from pathlib import Path

import click

PATH = click.Path(path_type=Path)


@click.group()
def sequence() -> None:
    """Look at recorded sequences, cut, import and export them."""


@sequence.command()
@click.argument("path", type=PATH, metavar="SEQ")
@click.option("--json", "as_json", is_flag=True, help="As JSON.")
def info(path: Path, as_json: bool) -> None:
    """Tell what SEQ holds."""
    from lfpipe.sequence.folder import EYES, TRUTH, open_sequence

    found = open_sequence(path, verify=False)
    codecs = sorted({packet.codec for packet in found.packets})
    size = sum(packet.bytes for packet in found.packets)
    about = {
        "frames": len(found.packets),
        "lost": found.lost,
        "duration_s": round(found.duration_s, 6),
        "rate_hz": round(found.measured_hz, 4),
        "width_px": found.width_px,
        "height_px": found.height_px,
        "codecs": codecs,
        "bytes": size,
        "complete": found.complete,
        "eyes": (path / EYES).exists(),
        "truth": (path / TRUTH).exists(),
        "source": found.manifest.get("source", ""),
        "created": found.manifest.get("created", ""),
        "versions": found.manifest.get("versions", {}),
    }
    if as_json:
        click.echo(json.dumps(about))
        return
    click.echo(f"{path}: {len(found.packets)} frames of {found.width_px}x{found.height_px}, {found.duration_s:.3f} s")
    click.echo(f"  {found.measured_hz:.3f} Hz by the stamps, {found.lost} frames lost while recording")
    click.echo(f"  {size / 1e6:.1f} MB as {', '.join(codecs)}, from {about['source']}, {about['created']}")
    beside = [name for name in ("eyes", "truth") if about[name]]
    click.echo(f"  beside the frames: {', '.join(beside) or 'nothing'}")
    if not found.complete:
        click.echo("  cut off while it was recorded: it ends with the last whole frame")


@sequence.command()
@click.argument("path", type=PATH, metavar="SEQ")
def check(path: Path) -> None:
    """Read all of SEQ: every checksum, every frame, every stamp."""
    from lfpipe.sequence.folder import open_sequence
    from lfpipe.sequence.truth import read_truth

    found = open_sequence(path)
    for packet in found.packets:
        found.frame(packet.seq)
    read_truth(path)
    state = "complete" if found.complete else "cut off while it was recorded, readable to its last whole frame"
    click.echo(f"{path}: {len(found.packets)} frames, all readable; {state}")


@sequence.command()
@click.argument("path", type=PATH, metavar="SEQ")
@click.argument("out", type=PATH)
@click.option("--from", "begin_s", type=click.FloatRange(min=0), default=0.0, metavar="S", help="Seconds after the first frame.")
@click.option("--to", "end_s", type=click.FloatRange(min=0), default=float("inf"), metavar="S", help="Up to, not including.")
def cut(path: Path, out: Path, begin_s: float, end_s: float) -> None:
    """Copy a part of SEQ to the new sequence OUT; its frames stay byte for byte what they are."""
    from lfpipe.sequence import edit
    from lfpipe.sequence.folder import open_sequence

    click.echo(f"{out}: {edit.cut(open_sequence(path), out, begin_s, end_s)} frames")


@sequence.command("import")
@click.argument("video", type=PATH)
@click.argument("out", type=PATH)
@click.option("--truth", type=PATH, metavar="CSV", help="Where the eyes really are, as tools/make_sequence.py writes it.")
def import_(video: Path, out: Path, truth: Path | None) -> None:
    """Make the sequence OUT from VIDEO; the frames of Motion JPEG are taken over unchanged."""
    from lfpipe.sequence import edit

    click.echo(f"{out}: {edit.from_video(video, out, truth)} frames")


@sequence.command()
@click.argument("path", type=PATH, metavar="SEQ")
@click.argument("video", type=PATH)
def export(path: Path, video: Path) -> None:
    """Write SEQ as VIDEO, .mkv or .avi without loss, and its stamps and eyes as a CSV beside it."""
    from lfpipe.sequence import edit
    from lfpipe.sequence.folder import open_sequence

    click.echo(f"{video}, {edit.export(open_sequence(path), video)}")
