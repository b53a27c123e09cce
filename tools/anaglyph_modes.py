"""The same viewpoint of the demo scene in every anaglyph mode, as one sheet: docs/anaglyph_modes.png.

    uv run python tools/anaglyph_modes.py [OUT.png]
"""

import argparse
import tempfile
from pathlib import Path
from typing import get_args, get_type_hints

import cv2
import numpy as np

from lfpipe.config import Render, Scene
from lfpipe.render.compositor import Compositor
from lfpipe.scene.demo import demo_scene
from lfpipe.scene.open_scene import open_scene

OUT = Path(__file__).resolve().parents[1] / "docs" / "anaglyph_modes.png"
SIDE_PX, COLUMNS, LABEL_PX = 256, 5, 22


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, nargs="?", default=OUT)
    out = parser.parse_args().out
    modes = get_args(get_args(get_type_hints(Render, include_extras=True)["anaglyph"])[0])
    with tempfile.TemporaryDirectory() as folder:
        scene = demo_scene(Path(folder), size_px=SIDE_PX)
        field = open_scene(scene, Scene(cache_dir=folder))
        middle = (field.rows - 1) / 2
        tiles = []
        for mode in modes:
            compositor = Compositor(field, Render(method="warp2", anaglyph=mode))
            picture = compositor.compose((middle, middle - 1.5), (middle, middle + 1.5))
            label = np.full((LABEL_PX, picture.shape[1], 3), 255, np.uint8)
            cv2.putText(label, mode, (4, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
            tiles.append(np.vstack([label, picture]))
    rows = [np.hstack(tiles[start : start + COLUMNS]) for start in range(0, len(tiles), COLUMNS)]
    out.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(out), np.vstack(rows), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(f"{out}: {out.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
