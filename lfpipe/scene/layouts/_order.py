"""The order of a line of numbered pictures, by the motion between them: counters roll over, and
programs number at random.

A picture is a neighbour of the two that look most like it. The order is proven if every picture
lies between its neighbours: motion to one is opposite to motion to the other.
"""

from collections.abc import Callable
from functools import cache
from itertools import combinations, pairwise

import numpy as np

from lfpipe.scene.layouts._running import MAX_PICTURES, normalised, unlikeness
from lfpipe.scene.optical_flow import Grey, returned_flow, textured, without_shake

_FEWEST_PX = 200  # of detail that is seen in three pictures
_LEAST_PX = 0.15  # of motion: the error of the flow
_FARTHER = 1.25  # a step of the names over the largest one of the chain: no neighbours


def _onward(before: Grey, here: Grey, after: Grey) -> float:
    """Cosine between the motion from the picture before and that to the picture after: positive if
    the camera moves on, negative if it turns back, 0 if too little moves. The larger one of all
    motion and of what is left without the turns of a hand.
    """
    if not before.shape == here.shape == after.shape:
        return 0.0
    (back, seen), (ahead, seen_too) = (returned_flow(here, other) for other in (before, after))
    detail = textured(here) & seen & seen_too
    if np.count_nonzero(detail) < _FEWEST_PX:
        return 0.0
    y, x = np.nonzero(detail)
    whole = [flow_px[detail] for flow_px in (-back, ahead)]
    steady = [without_shake(x, y, motion) for motion in whole]
    cosines = []
    for one, other in (whole, steady):
        first_px, second_px = (float(np.sqrt((way**2).sum(axis=1).mean())) for way in (one, other))
        if min(first_px, second_px) > _LEAST_PX:
            cosines.append(float((one * other).sum(axis=1).mean()) / (first_px * second_px))
    return max(cosines, default=0.0)


def _chained(order: list[int], unlike: Callable[[int, int], float]) -> list[int]:
    """The positions in one chain: the two most alike are neighbours, then the next two ends of
    chains, until one chain is left, in the direction in which more of the positions count up.
    """
    chains = {at: [at] for at in order}  # by both ends
    for a, b in sorted(combinations(order, 2), key=lambda pair: unlike(*pair)):
        if a in chains and b in chains and chains[a] is not chains[b]:
            one, other = chains.pop(a), chains.pop(b)
            both = (one if one[-1] == a else one[::-1]) + (other if other[0] == b else other[::-1])
            chains[both[0]] = chains[both[-1]] = both
    chain = next(iter(chains.values()))
    return chain if 2 * sum(a < b for a, b in pairwise(chain)) >= len(chain) - 1 else chain[::-1]


def motion_order(read: Callable[[int], Grey], positions: list[int]) -> tuple[list[int], int | None]:
    """(the positions of a line of pictures in the order that the motion proves, [] if it proves
    none; the first position that lies outside of its neighbours although the names put it between).

    read(position): a picture of a few hundred px.
    """

    @cache
    def onward(*three: int) -> float:
        return _onward(*map(read, three))

    def proven(order: list[int]) -> bool:
        return all(onward(*three) > 0 for three in zip(order, order[1:], order[2:], strict=False))

    look = cache(lambda at: normalised(read(at)))
    unlike = cache(lambda a, b: unlikeness(look(a), look(b)))

    def largest_step(order: list[int]) -> float:
        return max(unlike(*sorted(pair)) for pair in pairwise(order))

    if len(positions) <= MAX_PICTURES:
        chain = _chained(positions, unlike)
        near = largest_step(positions) < _FARTHER * largest_step(chain)
        for order in (positions, chain)[not near :]:
            if proven(order):
                return order, None
    some = positions[:: -(-len(positions) // MAX_PICTURES)]
    threes = zip(some, some[1:], some[2:], strict=False)
    return [], next((three[1] for three in threes if onward(*three) < 0), None)
