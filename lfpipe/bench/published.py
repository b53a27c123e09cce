"""Printed results of angular super-resolution, 2x2 -> 7x7 views. None of these methods was run here."""

import attrs

HCI_NEW, HCI_OLD, THIRTY = "HCI new", "HCI old", "30scenes"
# The test scenes of each set, by lower-case name; 30scenes are numbered photographs and not known by name.
TEST_SCENES = {
    HCI_NEW: ("bedroom", "bicycle", "dishes", "herbs"),
    HCI_OLD: ("buddha", "buddha2", "monasroom", "papillon", "stilllife"),
}


@attrs.frozen
class Row:
    """A method's printed means: {set: (PSNR in dB, SSIM)}. table: the publication from which the figures were copied."""

    method: str
    table: str
    means: dict[str, tuple[float, float]]


def _row(method: str, table: str, *means: tuple[float, float]) -> Row:
    return Row(method, table, dict(zip((HCI_NEW, HCI_OLD, THIRTY), means, strict=True)))


_DISTG = "table of DistgASR, Wang et al. 2022"
_ELFR = "table of ELFR, 2023"
# Tables disagree about the same method, by up to 5 dB; rows of different tables are not comparable in the last decibel.
ROWS = (
    _row("Kalantari 2016", _DISTG, (32.85, 0.909), (38.58, 0.944), (41.40, 0.982)),
    _row("Yeung 2018", _DISTG, (32.30, 0.900), (39.69, 0.941), (42.77, 0.986)),
    _row("LFASR-geo", _DISTG, (34.60, 0.937), (40.84, 0.960), (42.53, 0.985)),
    _row("FS-GAF", _DISTG, (37.14, 0.966), (41.80, 0.974), (42.75, 0.986)),
    _row("DistgASR", _DISTG, (34.70, 0.974), (42.18, 0.978), (43.67, 0.995)),
    _row("ELFR", _ELFR, (38.81, 0.973), (42.85, 0.982), (42.90, 0.987)),
)


def set_of(scene: str) -> str:
    """The set with a test scene of this name, or ""."""
    return next((name for name, scenes in TEST_SCENES.items() if scene.lower() in scenes), "")
