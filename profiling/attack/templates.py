"""Small valid inputs of every kind, made once, copied and damaged for each hostile one."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import h5py
import numpy as np
import scipy.io

from tests.scene import made

CFG = (
    "[intrinsics]\nfocal_length_mm = 100\nimage_resolution_x_px = 32\nimage_resolution_y_px = 24\nsensor_size_mm = 35\n"
    "[extrinsics]\nnum_cams_x = 3\nnum_cams_y = 3\nbaseline_mm = 25\nfocus_distance_m = 4.25\n[meta]\nscene = %(odd)s\n"
)


def hci(to: Path) -> None:
    made.write_grid(to, made.views(3, 3, 24, 32), "input_Cam{n:03d}.png")
    (to / "parameters.cfg").write_text(CFG)
    made.write_pfm(to / "gt_disp_lowres.pfm", made.middle_disparity(24, 32))
    made.write_pfm(to / "gt_disp_lowres_Cam002.pfm", made.middle_disparity(24, 32))


def hci_old(to: Path) -> None:
    grid = made.views(3, 3, 24, 32)
    depth = (0.5 * 20 / (made.middle_disparity(24, 32) + 3)).astype(np.float32)
    with h5py.File(to / "lf.h5", "w") as file:
        file["LF"] = grid[:, ::-1]
        file.attrs.update({"dH": 0.5, "focalLength": 20.0, "shift": 3.0, "hRes": 3})
        file["GT_DEPTH"] = np.broadcast_to(depth, (3, 3, 24, 32))


def hci_text(to: Path) -> None:
    made.write_grid(to / "lf", made.views(3, 3, 24, 32), "{r:02d}_{c:02d}.png")
    values = {"xRes": 32, "yRes": 24, "hRes": 3, "vRes": 3, "dH": 0.5, "shift": 3, "focalLength": 20}
    (to / "attributes.dat").write_text("".join(f"{value:e} //{name}\n" for name, value in values.items()))
    (to / "depth.bin").write_bytes((10 / (made.middle_disparity(24, 32) + 3)).astype("<f4").tobytes())


def stanford(to: Path) -> None:
    grid = made.views(3, 3, 24, 32)
    for r in range(3):
        for c in range(3):
            made.write(to / f"out_{r:02d}_{c:02d}_{-300 - 8.5 * r:.6f}_{1100.0 - 8.6 * c:.6f}_.jpg", grid[2 - r, 2 - c])


def jpeg_pleno(to: Path) -> None:
    grid = made.views(3, 3, 24, 32).astype(np.uint16) * 4
    for r in range(3):
        for c in range(3):
            made.write_ppm(to / f"{r:03d}_{c:03d}.ppm", grid[r, c], 1023)


def mat_old(to: Path) -> None:
    scipy.io.savemat(to / "scene.mat", {"LF": made.views(3, 3, 24, 32)})


def mat_new(to: Path) -> None:
    whole = made.views(3, 3, 24, 32).astype(np.uint16) * 257
    with h5py.File(to / "IMG__Decoded.mat", "w", userblock_size=512) as file:
        file.create_dataset("LF", data=whole.transpose(4, 3, 2, 1, 0), chunks=True, compression="gzip")
        file["LFMetadata"] = np.zeros(1)
    with (to / "IMG__Decoded.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")


def eslf(to: Path) -> None:
    whole = made.views(7, 7, 24, 30, 0.4, -0.2)
    made.write(to / "IMG_eslf.png", whole.transpose(2, 0, 3, 1, 4).reshape(24 * 7, 30 * 7, 3))


def mosaic(to: Path) -> None:
    made.write(to / "toys_3x3.png", made.mosaic(made.views(3, 3, 48, 64)))


def mosaic_video(to: Path) -> None:
    for n in range(3):
        made.write(to / f"lf_3x3_{n:03d}.png", made.mosaic(made.views(3, 3, 48, 64)))


def mosaic_file(to: Path) -> None:
    picture = cv2.cvtColor(made.mosaic(made.views(3, 3, 48, 64)), cv2.COLOR_RGB2BGR)
    writer = cv2.VideoWriter(str(to / "lf_3x3.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 12.0, (192, 144))
    for _ in range(3):
        writer.write(picture)
    writer.release()


def numbered(to: Path) -> None:
    made.write_grid(to, made.views(3, 3, 24, 32), "v{n:03d}.png")


def picture(to: Path) -> None:
    made.write(to / "one.tif", made.views(3, 3, 24, 32)[1, 1])


def quilt(to: Path) -> None:
    made.write(to / "shop_qs3x3a1.png", made.mosaic(made.views(3, 3, 24, 32)))


def rows_cols(to: Path) -> None:
    made.write_grid(to, made.views(3, 3, 24, 32), "view_{r:02d}_{c:02d}.bmp")


LAYOUTS: tuple[Callable[[Path], None], ...] = (
    hci, hci_old, hci_text, stanford, jpeg_pleno, mat_old, mat_new, eslf, mosaic, mosaic_video, mosaic_file, numbered, picture,
    quilt, rows_cols,
)  # fmt: skip


def sequence(to: Path) -> None:
    """Eight frames, PNG and JPEG and raw, with eyes and truth."""
    from lfpipe.sequence.folder import EYES, TRUTH, begin_manifest, end_manifest
    from lfpipe.sequence.packets import PacketWriter

    manifest = begin_manifest(to, "demo", 32, 24, 30.0, versions={"lfpipe": "0"}, config={"camera": {"width_px": 32}})
    writer = PacketWriter(to)
    frame = np.full((24, 32, 3), 90, np.uint8)
    kinds = {
        "png": cv2.imencode(".png", frame)[1].tobytes(),
        "jpeg": cv2.imencode(".jpg", frame)[1].tobytes(),
        "raw": frame.tobytes(),
    }
    eyes, truth = [], ["source_seq,t_ns,left_x_px,left_y_px,right_x_px,right_y_px,visible"]
    for n in range(8):
        kind = ("png", "jpeg", "raw")[n % 3]
        writer.append(kinds[kind], kind, n, 0, 10**9 + n * 33_333_333, 10**9 + n * 33_333_333 + 1000)
        points = [[20.0, 10.0], [12.0, 10.0]]
        eyes.append(json.dumps({"source_seq": n, "face": 1, "raw_px": points, "filtered_px": points}))
        truth.append(f"{n},{n * 33_333_333},20.0,10.0,12.0,10.0,1")
    writer.close()
    (to / EYES).write_text("\n".join(eyes) + "\n")
    (to / TRUTH).write_text("\n".join(truth) + "\n")
    end_manifest(to, manifest, writer.count, writer.checksums())


def trace(to: Path) -> None:
    """A trace as `lfpipe up --trace` writes it."""
    lines = []
    for n in range(6):
        t = 10**9 + n * 33_333_333
        sides = {"left": [20.0, 10.0], "right": [12.0, 10.0]}
        lines.append(
            json.dumps(
                {
                    "seq": n,
                    "source_seq": n,
                    "epoch": 0,
                    "t_sensor_ns": t,
                    "t_read_ns": t + 1000,
                    "t_tracked_ns": t + 2000,
                    "t_composed_ns": t + 3000,
                    "t_presented_ns": t + 4000,
                    "face": True,
                    "eyes_raw": sides,
                    "eyes_used": sides,
                    "view": {"left": [1.0, 1.0], "right": [1.0, 1.2]},
                    "method": "warp",
                    "composed": True,
                }
            )
        )  # fmt: skip
    (to / "trace.jsonl").write_text("\n".join(lines) + "\n")


def config(to: Path) -> None:
    from lfpipe.config.text import commented

    (to / "config.toml").write_text(commented())


def budget(to: Path) -> None:
    (to / "budget.toml").write_text(
        '[[budget]]\nfigure = "counts.dropped.track"\nmost = 0\nmachine = "any"\n\n'
        '[[budget]]\nfigure = "latency.render.busy.p95_ms"\nover = "latency.track.busy.p95_ms"\nmost = 2.0\n'
    )


OTHERS: tuple[Callable[[Path], None], ...] = (sequence, trace, config, budget)


def make_all(to: Path) -> None:
    """One folder for each."""
    for make in (*LAYOUTS, *OTHERS):
        (to / make.__name__).mkdir(parents=True)
        make(to / make.__name__)
