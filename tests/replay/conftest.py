"""A sequence of the demo's face in known motion, made anew for the tests, and a scene whose views
tell themselves.

Both are the same to the last bit in OpenCV 4 and 5, so that one reference holds for all.
"""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe.capture.recordings import (
    EYE_DISTANCE_PX,
    FRAME_PX,
    PORTRAIT_EYES_PX,
    backdrop,
    demo_eyes_px,
)
from lfpipe.sequence.folder import new_sequence
from lfpipe.sequence.packets import TRUTH
from lfpipe.track.network import portable_warp

SIZE = (320, 240)
RATE_HZ = 30.0
QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 80]


class Portrait:
    """The demo's portrait, drawn without OpenCV's own warp, which is another one in OpenCV 5 than
    in OpenCV 4.
    """

    def __init__(self) -> None:
        picture, middle = backdrop(*SIZE)
        self._picture = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2BGRA), np.uint8)
        eye_distance = PORTRAIT_EYES_PX - PORTRAIT_EYES_PX.mean(axis=0)
        scale = (
            EYE_DISTANCE_PX
            * SIZE[0]
            / FRAME_PX[0]
            / np.linalg.norm(eye_distance[0] - eye_distance[1])
        )
        self._eyes = (middle + eye_distance * scale) @ (1, 1j)

    def at(self, eyes_px: np.ndarray) -> np.ndarray:
        """With the eyes there: turned, scaled and moved as they say, uint8 (height, width,
        3) BGR.
        """
        there = eyes_px @ (1, 1j)
        turn = (self._eyes[0] - self._eyes[1]) / (there[0] - there[1])
        move = self._eyes.mean() - turn * there.mean()
        matrix = np.array([[turn.real, -turn.imag, move.real], [turn.imag, turn.real, move.imag]])
        square = portable_warp(self._picture, matrix, max(SIZE), cv2.BORDER_REPLICATE)
        return square[: SIZE[1], : SIZE[0], :3]


def make_sequence(out: Path, frames: int) -> Path:
    """Frames of the demo as JPEG, with the truth beside them."""
    portrait = Portrait()
    with (
        new_sequence(
            out, "demo", SIZE, RATE_HZ, made=f"portrait {SIZE} {frames} {QUALITY}"
        ) as writer,
        (out / TRUTH).open("w", newline="") as file,
    ):
        rows = csv.writer(file)
        rows.writerow(
            ["source_seq", "t_ns", "left_x_px", "left_y_px", "right_x_px", "right_y_px", "visible"]
        )
        for seq in range(frames):
            t_ns = round(seq * 1e9 / RATE_HZ)
            eyes_px = demo_eyes_px(t_ns / 1e9, *SIZE)
            data = cv2.imencode(".jpg", portrait.at(eyes_px), QUALITY)[1].tobytes()
            writer.append(data, "jpeg", seq, 0, 5_000_000_000 + t_ns, 5_000_100_000 + t_ns)
            rows.writerow([seq, t_ns, *eyes_px.ravel().tolist(), 1])
    return out


@pytest.fixture(scope="session")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """10 s."""
    return make_sequence(tmp_path_factory.mktemp("sequences") / "walk", 300)


@pytest.fixture(scope="session")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """2 s."""
    return make_sequence(tmp_path_factory.mktemp("sequences") / "short", 60)


@pytest.fixture(scope="session")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """5x5 views of coloured blocks that shift by a pixel a view; whole numbers only, so every
    version of numpy makes the same.
    """
    folder = tmp_path_factory.mktemp("scenes") / "blocks"
    folder.mkdir()
    y, x = np.mgrid[0:48, 0:80]
    for row in range(5):
        for col in range(5):
            at_x, at_y = (x + 2 - col) // 8, (y + 2 - row) // 8
            view = np.stack(
                [
                    (at_x * 37 + at_y * 59) % 256,
                    (at_x * 91 + at_y * 23) % 256,
                    (at_x * 53 + at_y * 71) % 256,
                ],
                axis=2,
            )
            cv2.imwrite(str(folder / f"view_{row}_{col}.png"), view.astype(np.uint8))
    return folder
