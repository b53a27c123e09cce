"""Types of arguments: a program's mistake raises TypeError that names the parameter."""

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from beartype import BeartypeConf, beartype
from numpy.typing import NDArray

if TYPE_CHECKING:
    from numpy.typing import ArrayLike as ArrayLike

    Number: TypeAlias = float
    WholeNumber: TypeAlias = int
else:  # what is accepted when it runs: numbers of numpy, and for arrays whatever `numbers` accepts
    ArrayLike = object
    WholeNumber = int | np.integer
    Number = float | np.floating | WholeNumber

typed = beartype(
    conf=BeartypeConf(is_color=False, is_pep484_tower=True, violation_param_type=TypeError)
)


def numbers(name: str, value: Any) -> NDArray[Any]:
    """value as an array. Raises TypeError that names the parameter if it has no numbers."""
    try:
        array = np.asarray(value)
    except ValueError as error:  # rows of several lengths
        raise TypeError(f"{name} must be an array: {error}") from None
    if array.dtype.kind not in "buif":
        what = f"an array of {array.dtype}" if array.ndim else type(value).__name__
        raise TypeError(f"{name} must be an array of numbers, not {what}")
    return array
