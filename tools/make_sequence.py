"""A video of a face in known motion, from any portrait picture, and the truth about its eyes.

    python -m tools.make_sequence OUT.avi [--portrait PICTURE] [--seconds S] [--rate HZ] [--noise
    DN] [--seed N]

Writes OUT.avi (640x480 Motion JPEG of high quality: every frame stands alone, cv2.VideoCapture
reads it) and OUT.csv, the truth:

    source_seq,t_ns,left_x_px,left_y_px,right_x_px,right_y_px,visible,phase

one row per frame: source_seq counts frames from 0; t_ns is the frame's time from the start of the
video; eye centres (mean of the 16 periocular landmarks, the viewer's own left and right) in px of
the unmirrored picture, with pixel centres at whole numbers; visible is 1 while both eyes are inside
the picture; phase is still, reach, sway, stop, approach, retreat, leave or enter. The path is
tools/head_path.py:viewer_path. The landmarks are found once, on a noise-free picture of the
portrait; from then on truth is the known map from portrait to picture. Without --portrait: the
demo's portrait.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import click
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.bench.inputs import SIZE_PX, write_video
from lfpipe.capture.demo import PORTRAIT
from lfpipe.errors import UserError
from lfpipe.track.litert_engine import LitertEngine

sys.path.insert(0, str(Path(__file__).parents[1]))

from tools.head_path import EYES_MM, FOCAL_PX, HOME_MM, duration_s, path_at, viewer_path

WIDTH_PX, HEIGHT_PX = SIZE_PX
BACKGROUND = np.array([96, 92, 88], np.float32)


class Puppet:
    """A portrait that can be placed anywhere before a pinhole camera.

    portrait: uint8 (h, w, 3) BGR. Raises UserError where no face is found in it.
    """

    def __init__(self, portrait: NDArray[np.uint8]) -> None:
        engine = LitertEngine()
        face = engine.detect(portrait)
        if face is None:
            raise UserError(
                "no face found in the portrait", "give a picture of one person from the front"
            )
        # first to the size it has at home, with proper averaging:
        # the warps that follow then hardly change it
        factor = (
            EYES_MM * FOCAL_PX / HOME_MM / float(np.linalg.norm(face.eyes_px[0] - face.eyes_px[1]))
        )
        how = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
        self._picture = cv2.resize(portrait, None, fx=factor, fy=factor, interpolation=how)
        height_px, width_px = self._picture.shape[:2]
        edge = np.zeros((height_px, width_px), np.float32)
        edge[12:-12, 12:-12] = 1.0
        self._mask = cv2.GaussianBlur(edge, (0, 0), 5.0)[..., None]
        self._middle = face.eyes_px.mean(axis=0) * factor
        home = np.array([0.0, 0.0, HOME_MM])
        still = self.draw(home).astype(np.uint8)
        map_ = self.map(home)
        engine.reset()
        for _ in range(5):  # the region of interest settles
            face = engine.detect(still)
        if face is None:
            raise UserError(
                "the face of the portrait is lost when scaled", "give a larger or sharper picture"
            )
        self._eyes = (face.eyes_px - map_[:, 2]) @ np.linalg.inv(map_[:, :2]).T

    def map(self, position_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Affine (2, 3) from px of the scaled portrait to px of the picture."""
        x, y, z = position_mm
        scale = HOME_MM / z
        middle = np.array(
            [(WIDTH_PX - 1) / 2 + FOCAL_PX * x / z, (HEIGHT_PX - 1) / 2 + FOCAL_PX * y / z]
        )
        return np.column_stack([np.eye(2) * scale, middle - self._middle * scale])

    def eyes_px(self, position_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """True eye centres, (2, 2), left first."""
        map_ = self.map(position_mm)
        return np.asarray(self._eyes @ map_[:, :2].T + map_[:, 2], np.float64)

    def draw(self, position_mm: NDArray[np.float64]) -> NDArray[np.float32]:
        """The picture without noise: float32 (480, 640, 3), 0..255."""
        map_ = self.map(position_mm)
        size = (WIDTH_PX, HEIGHT_PX)
        face = cv2.warpAffine(
            self._picture, map_, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        mask = np.asarray(
            cv2.warpAffine(self._mask, map_, size, flags=cv2.INTER_LINEAR), np.float32
        )[..., None]
        return np.asarray(mask * face + (1 - mask) * BACKGROUND, np.float32)


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
@click.option("--seed", default=1, show_default=True, help="Of the noise.")
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

    Raises UserError where the portrait cannot be read, holds no face, or OUT cannot be written.
    """
    picture = cv2.imread(str(portrait))
    if picture is None:
        raise UserError(f"{portrait}: not a picture that can be read", "give a JPEG or PNG file")
    puppet = Puppet(np.asarray(picture, np.uint8))
    path = viewer_path(HOME_MM, WIDTH_PX / 2 * HOME_MM / FOCAL_PX)
    count = round((min(seconds, duration_s(path)) if seconds else duration_s(path)) * rate_hz)
    rng = np.random.default_rng(seed)

    def frames() -> Iterator[tuple[NDArray[np.uint8], NDArray[np.float64], bool, str]]:
        for place, phase in zip(*path_at(path, np.arange(count) / rate_hz), strict=True):
            image = puppet.draw(place) + rng.standard_normal(
                (HEIGHT_PX, WIDTH_PX, 3), np.float32
            ) * np.float32(noise_dn)
            eyes = puppet.eyes_px(place)
            inside = bool(np.all(eyes >= 0) and np.all(eyes < SIZE_PX))
            yield np.clip(np.rint(image), 0, 255).astype(np.uint8), eyes, inside, phase

    video = out.with_suffix(".avi")
    write_video(video, rate_hz, frames())
    click.echo(
        f"{video}: {count} frames at {rate_hz:g} Hz, noise {noise_dn:g} DN; truth in"
        f" {video.with_suffix('.csv')}"
    )


if __name__ == "__main__":
    main()
