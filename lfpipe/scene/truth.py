"""Plausible true disparity of a scene."""

import attrs
import numpy as np

from lfpipe.errors import UserError
from lfpipe.scene.source import SceneSource


def without_implausible_truth(source: SceneSource) -> SceneSource:
    """source without maps that claim more than a picture's side per view; a note reports them.

    Such values would stretch the range until the whole scene looks flat. Raises UserError if a map differs in size from the
    views, holds NaN, or cannot be read.
    """
    if source.rendered:
        return source
    size, remedy = (source.height_px, source.width_px), "remove the map to have disparity estimated"
    largest: dict[tuple[int, int], float] = {}
    for (row, col), read in source.truth.items():
        found = read()
        where = f"{source.path}: true disparity of the view in row {row} column {col}"
        if found.shape != size:
            raise UserError(f"{where} has {found.shape[1]}x{found.shape[0]} values, the views {size[1]}x{size[0]} px", remedy)
        if bad := int(np.count_nonzero(~np.isfinite(found))):
            raise UserError(f"{where}: {bad} of {found.size} values are NaN or infinite", remedy)
        most = float(np.abs(found).max())
        if most > max(size):
            largest[row, col] = most
    if not largest:
        return source
    (row, col), most = next(iter(largest.items()))
    note = (
        f"true disparity of {len(largest)} views is not used: up to {most:g} px per view in row {row} column {col}, "
        f"but the views have {size[1]}x{size[0]} px"
    )
    kept = {place: read for place, read in source.truth.items() if place not in largest}
    return attrs.evolve(source, truth=kept, notes=(*source.notes, note))
