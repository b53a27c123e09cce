"""A video of a face in known motion, from any portrait picture, and the truth about its eyes.

    python -m tools.make_sequence OUT.avi [--portrait PICTURE] [--seconds S] [--rate HZ] [--noise
    DN] [--seed N]

Writes OUT.avi (640x480 Motion JPEG of high quality: every frame stands alone, cv2.VideoCapture
reads it) and OUT.csv, the truth:

    source_seq,t_ns,left_x_px,left_y_px,right_x_px,right_y_px,visible,phase

one row per frame: source_seq counts frames from 0; t_ns is the frame's time from the start of the
video; eye centres (mean of the 16 periocular landmarks, the viewer's own left and right) in px of
the unmirrored picture, with pixel centres at whole numbers; visible is 1 while both eyes are inside
the picture; phase is still or move. The face moves as the viewers of `lfpipe bench viewer` do: PATH
is in the terms of lfpipe/bench/simulator/scripts.py. The landmarks are found once, on a noise-free
picture of the portrait; from then on truth is the known map from portrait to picture. Without
--portrait: the demo's portrait.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import click
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import write_video
from lfpipe.bench.simulator.scripts import OUT_RIGHT, SEAT, Move, Place, path, swayed
from lfpipe.capture.recordings import FRAME_PX, PORTRAIT
from lfpipe.errors import UserError
from lfpipe.track.litert_engine import LitertEngine

BACKGROUND = np.array([96, 92, 88], np.float32)
# reaches, sways, stops suddenly, comes nearer and goes back, leaves and returns; rests between them
PATH = swayed(
    path(
        25.0,
        SEAT,
        Move(2.0, 3.0, (430.0, 240.0, 60.0)),
        Move(4.0, 5.5, (250.0, 260.0, 60.0)),
        Move(6.5, 7.3, SEAT),
        Move(14.0, 14.3, (410.0, 240.0, 60.0), even=True),
        Move(15.3, 16.3, SEAT),
        Move(17.3, 18.5, (320.0, 240.0, 85.0)),
        Move(19.5, 20.7, SEAT),
        Move(21.7, 22.7, OUT_RIGHT),
        Move(23.0, 24.0, SEAT),
    ),
    reach_px=60.0,
    rate_hz=0.6,
    from_s=8.0,
    to_s=13.0,
)


class Puppet:
    """A portrait that can be placed anywhere before the camera.

    portrait: uint8 (h, w, 3) BGR. Raises UserError if no face is found in it.
    """

    def __init__(self, portrait: NDArray[np.uint8]) -> None:
        engine = LitertEngine()
        face = engine.detect(portrait)
        if face is None:
            raise UserError(
                "no face found in the portrait", "give a picture of one person from the front"
            )
        # first to the size that it has at the seat, with proper averaging:
        # the warps that follow then hardly change it
        factor = SEAT[2] / float(np.linalg.norm(face.eyes_px[0] - face.eyes_px[1]))
        how = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
        self._picture = cv2.resize(portrait, None, fx=factor, fy=factor, interpolation=how)
        edge = np.zeros(self._picture.shape[:2], np.float32)
        edge[12:-12, 12:-12] = 1.0
        self._mask = cv2.GaussianBlur(edge, (0, 0), 5.0)
        self._middle = face.eyes_px.mean(axis=0) * factor
        still = self.draw(SEAT).astype(np.uint8)
        engine.reset()
        for _ in range(5):  # the region of interest settles
            face = engine.detect(still)
        if face is None:
            raise UserError(
                "the face of the portrait is lost when scaled", "give a larger or sharper picture"
            )
        self._eyes_px = face.eyes_px - SEAT[:2]

    def eyes_px(self, place: Place) -> NDArray[np.float64]:
        """True eye centres, (2, 2), left first."""
        x, y, eye_distance_px = place
        return np.asarray(self._eyes_px * eye_distance_px / SEAT[2] + (x, y), np.float64)

    def draw(self, place: Place) -> NDArray[np.float32]:
        """The picture without noise: float32 (480, 640, 3), 0..255."""
        x, y, eye_distance_px = place
        scale = eye_distance_px / SEAT[2]
        move = (x, y) - self._middle * scale
        matrix = np.column_stack([np.eye(2) * scale, move])
        face = cv2.warpAffine(
            self._picture, matrix, FRAME_PX, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        share = cv2.warpAffine(self._mask, matrix, FRAME_PX)[..., None]
        return np.asarray(share * face + (1 - share) * BACKGROUND, np.float32)


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option(
    "--portrait",
    type=click.Path(path_type=Path),
    help="Picture of a face; the demo's portrait without it.",
)
@click.option("--seconds", type=click.FloatRange(0.1), help="Cut the path off here.")
@click.option(
    "--rate",
    default=30.0,
    type=click.FloatRange(1, 240),
    show_default=True,
    help="Frames per second.",
)
@click.option(
    "--noise",
    default=2.0,
    type=click.FloatRange(0, 50),
    show_default=True,
    help="Deviation of the sensor noise, DN.",
)
@click.option("--seed", default=1, show_default=True, help="Seed of the noise.")
def main(
    out: Path, portrait: Path | None, seconds: float | None, rate: float, noise: float, seed: int
) -> None:
    """Writes OUT.avi and OUT.csv: a face in known motion and where its eyes are."""
    cv2.setNumThreads(1)
    try:
        write(out, portrait or PORTRAIT, seconds, rate, noise, seed)
    except UserError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(2)


def write(
    out: Path, portrait: Path, seconds: float | None, rate_hz: float, noise_dn: float, seed: int
) -> None:
    """See the module.

    Raises UserError if the portrait cannot be read or has no face, or OUT cannot be written.
    """
    picture = cv2.imread(str(portrait))
    if picture is None:
        raise UserError(f"{portrait}: not a picture that can be read", "give a JPEG or PNG file")
    puppet = Puppet(np.asarray(picture, np.uint8))
    long_s = len(PATH) / 1000
    count = round(min(seconds or long_s, long_s) * rate_hz)
    rng = np.random.default_rng(seed)
    moves = np.abs(np.diff(PATH, axis=0, append=PATH[-1:])).sum(axis=1) > 0

    def frames() -> Iterator[tuple[NDArray[np.uint8], NDArray[np.float64], bool, str]]:
        for ms in (np.arange(count) * 1000 / rate_hz).astype(int):
            x, y, eye_distance_px = PATH[ms].tolist()
            place = x, y, eye_distance_px
            noise = rng.standard_normal((*FRAME_PX[::-1], 3), np.float32) * np.float32(noise_dn)
            image = np.clip(np.rint(puppet.draw(place) + noise), 0, 255).astype(np.uint8)
            eyes = puppet.eyes_px(place)
            inside = bool(np.all(eyes >= 0) and np.all(eyes < FRAME_PX))
            yield image, eyes, inside, "move" if moves[ms] else "still"

    video = out.with_suffix(".avi")
    write_video(video, rate_hz, frames())
    click.echo(
        f"{video}: {count} frames at {rate_hz:g} Hz, noise {noise_dn:g} DN; truth in"
        f" {video.with_suffix('.csv')}"
    )


if __name__ == "__main__":
    main()
