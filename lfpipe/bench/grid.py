"""Benchmark: effect of the spacing of the view grid on movement and depth, for viewers at several
distances: the paper's experiment "Grid Distance Affection", with metrics.

Geometry is exact; the pictures of the eyes are drawn and compared in the simulator.
"""

import math
from collections.abc import Iterator
from functools import cache, partial

import attrs
import numpy as np

from lfpipe.bench.inputs import Inputs
from lfpipe.bench.paper_loop import PAPER_ALPHA_PX
from lfpipe.bench.results import Metrics, Value
from lfpipe.bench.runner import Offer, Prepared, Variant
from lfpipe.bench.simulator.camera import IMAGE
from lfpipe.bench.simulator.metrics import Pictures, samples
from lfpipe.bench.simulator.run import Setup, Truth
from lfpipe.bench.simulator.scene import SCENES, SimulatedScene, scene_of
from lfpipe.bench.simulator.scripts import Script, path, person, settled, swayed
from lfpipe.config import Config, Render
from lfpipe.config.camera_pose import camera_focal_px
from lfpipe.render.viewer.geometry import FUSED_RAD, PICTURE_MM, Parallax, parallax
from lfpipe.render.viewer.presence import RestingEyes
from lfpipe.scene.lightfield import LightField
from lfpipe.scene.source import Geometry

DISTANCES_MM = (400.0, 600.0, 800.0)
ALPHAS_PX = (4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0)  # from dense to sparse
AUTOMATIC = 0.0  # render.alpha_px = "auto"
CAPTURE = Geometry(baseline_mm=20.0, focus_distance_mm=1000.0)  # assumed for the simulated scene
PLACES = 25  # start positions of a move of 1 cm, over the grid
SWAY_MM = 42.0
PICTURES = (4, 12)  # of the sway to compare, quick and full


@cache
def _scene(alpha_px: float) -> SimulatedScene:
    return attrs.evolve(scene_of(SCENES[0]), alpha_px=alpha_px or None)


@attrs.frozen
class Spacing:
    """A spacing of the grid, for a viewer at a distance."""

    alpha_px: float
    """px of the camera picture per view, or AUTOMATIC."""
    distance_mm: float

    @property
    def eyes_px(self) -> float:
        """Eye distance in the camera picture."""
        config = Config()
        return camera_focal_px(config, IMAGE.shape[1]) * config.screen.eyes_mm / self.distance_mm

    @property
    def field(self) -> LightField:
        return attrs.evolve(_scene(AUTOMATIC).field, geometry=CAPTURE)

    @property
    def parallax(self) -> Parallax:
        """The parallax that the product chooses."""
        config = Config(render=Render(alpha_px=self.alpha_px or "auto"))
        return parallax(config, self.field, IMAGE.shape[1], self.eyes_px)

    def geometry(self) -> Metrics:
        """Exact zone, responsiveness, depth and disparity."""
        field, chosen = self.field, self.parallax
        mm_per_px = Config().screen.eyes_mm / self.eyes_px
        views = chosen.views_between_eyes
        zone_mm = max(field.cols - 1 - views, 0.0) * chosen.alpha_px * mm_per_px
        extent_px = max(
            field.disparity_max_px - chosen.zero_plane_px,
            chosen.zero_plane_px - field.disparity_min_px,
        )
        disparity_mm = views * extent_px * PICTURE_MM / field.width_px
        return {
            "zone_mm": zone_mm,
            "zone_deg": 2 * math.degrees(math.atan(zone_mm / 2 / self.distance_mm)),
            "views_per_cm": 10 / mm_per_px / chosen.alpha_px,
            "depth": 100 * (chosen.compression or 0.0),
            "disparity_deg": math.degrees(disparity_mm / self.distance_mm),
        }

    def largest_step(self, method: str) -> float:
        """Largest RMS difference, levels, of pictures 1 cm of head movement apart."""
        pictures = Pictures(Setup(scene=_scene(AUTOMATIC), method=method))
        field = self.field
        moved = min(self.geometry()["views_per_cm"], field.cols - 1.0)

        def drawn(col: float) -> np.ndarray:
            at = np.array([[(field.rows - 1) / 2, col]] * 2)
            return pictures.draw(pictures.key(at)).astype(np.float32)

        starts = np.linspace(0, field.cols - 1 - moved, PLACES).tolist()
        steps = [np.mean(np.square(drawn(col + moved) - drawn(col))) for col in starts]
        return float(np.sqrt(max(steps)))

    def error(self, count: int) -> float:
        """Error of the picture of each eye while the viewer sways, RMS levels."""
        script = _sways(self.eyes_px)
        setup = Setup(scene=_scene(self.alpha_px))
        run = setup.watch(script)
        at = samples(run, script, count)
        right = Truth(setup, script).at(run.ms[at])
        return float(Pictures(setup).errors([run.keys[k] for k in at], right).levels.mean())


@cache
def _sways(eyes_px: float) -> Script:
    """A viewer with this eye distance in the camera picture who sways by SWAY_MM."""
    seat = (IMAGE.shape[1] / 2, IMAGE.shape[0] / 2, eyes_px)
    places = swayed(path(6.0, seat), SWAY_MM * eyes_px / Config().screen.eyes_mm, 0.5)
    return Script(
        name="sways", people=(person(places),), windows=(settled(6.0, rest=RestingEyes(*seat)),)
    )


def measure(inputs: Inputs) -> Iterator[Offer]:
    """A variant for each spacing and distance."""
    count = PICTURES[not inputs.quick]
    for distance_mm in DISTANCES_MM:
        for alpha_px in (AUTOMATIC, *ALPHAS_PX):
            spacing = Spacing(alpha_px, distance_mm)
            is_comfortable = math.radians(spacing.geometry()["disparity_deg"]) <= FUSED_RAD
            yield Variant(
                curve=f"{distance_mm / 10:g} cm{'' if is_comfortable else ', beyond comfort'}",
                parameter=f"alpha {spacing.parallax.alpha_px:.3g} px"
                + (" (auto)" if alpha_px == AUTOMATIC else ""),
                prepare=partial(_prepare, spacing, count),
                paper=alpha_px == PAPER_ALPHA_PX,
                used=alpha_px == AUTOMATIC,
            )


def _prepare(spacing: Spacing, count: int) -> Prepared:
    metrics = spacing.geometry() | {
        "step_nearest": spacing.largest_step("nearest"),
        "step_warp2": spacing.largest_step("warp2"),
        "error_levels": spacing.error(count),
    }
    return {name: Value(value) for name, value in metrics.items()}, None
