"""A sequence of the demo's face in known motion, made anew for the tests, and a scene whose views tell themselves."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfpipe import config
from lfpipe.capture.demo import DemoSource, demo_eyes_px
from lfpipe.replay.packets import PacketWriter
from lfpipe.replay.sequence import TRUTH, begin_manifest, check_out, end_manifest, open_sequence

SIZE = (320, 240)
RATE_HZ = 30.0
QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 80]


def make_sequence(out: Path, frames: int) -> Path:
    """Frames of the demo as JPEG, with the truth beside them."""
    camera = config.Camera(width_px=SIZE[0], height_px=SIZE[1], rate_hz=RATE_HZ)
    source = DemoSource(camera)
    check_out(out)
    manifest = begin_manifest(out, "demo", *SIZE, RATE_HZ, made=f"demo {SIZE} {frames} {QUALITY}")
    writer = PacketWriter(out)
    picture = np.empty((SIZE[1], SIZE[0], 3), np.uint8)
    with (out / TRUTH).open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["source_seq", "t_ns", "left_x_px", "left_y_px", "right_x_px", "right_y_px", "visible"])
        for seq in range(frames):
            source.read(picture)
            t_ns = round(seq * 1e9 / RATE_HZ)
            data = cv2.imencode(".jpg", picture, QUALITY)[1].tobytes()
            writer.append(data, "jpeg", seq, 0, 5_000_000_000 + t_ns, 5_000_100_000 + t_ns)
            rows.writerow([seq, t_ns, *demo_eyes_px(t_ns / 1e9, *SIZE).ravel().tolist(), 1])
    writer.close()
    end_manifest(out, manifest, writer.count, writer.checksums())
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
    """5x5 views of coloured blocks that shift by a pixel a view; whole numbers only, so every version of numpy makes the same."""
    folder = tmp_path_factory.mktemp("scenes") / "blocks"
    folder.mkdir()
    y, x = np.mgrid[0:48, 0:80]
    for row in range(5):
        for col in range(5):
            at_x, at_y = (x + 2 - col) // 8, (y + 2 - row) // 8
            view = np.stack([(at_x * 37 + at_y * 59) % 256, (at_x * 91 + at_y * 23) % 256, (at_x * 53 + at_y * 71) % 256], axis=2)
            cv2.imwrite(str(folder / f"view_{row}_{col}.png"), view.astype(np.uint8))
    return folder


def frames_of(path: Path) -> int:
    return len(open_sequence(path).packets)
