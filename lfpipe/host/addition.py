"""Addition with the same bits under every Python: from Python 3.12 on, `sum` compensates rounding errors."""

from collections.abc import Iterable


def add(values: Iterable[float]) -> float:
    """The sum, rounded at each step from the first to the last."""
    total = 0.0
    for value in values:
        total += value
    return total
