"""Interprets the numbers in the names of pictures: row and column, or a running number.
docs/layouts.md states the rules.

A name is split into texts and numbers; names with the same texts form a family. Two numbers are row
and column if they vary, neither is a counter, and their pairs explain nearly all names.
"""

import math
import re
from collections import defaultdict
from collections.abc import Collection, Iterator
from functools import lru_cache
from itertools import combinations

import attrs

from lfpipe.scene.files import stem_of
from lfpipe.scene.source import ViewIndex

MAPS = re.compile(
    r"depth|disp|mask|matte|alpha|label|seg|normal|flow(?!er)|conf(?!e)|thumb|error|diff"
    r"|(?<![a-z])gt|(?<![a-z])class(es)?(?![a-z])",
    re.IGNORECASE,
)
_SIDES = re.compile(r"(?<![a-z])(left|l|right|r)(?![a-z])")
_RUN = 0.9  # share of a family that row and column must explain to outrank a running number
MAX_SIDE = 10_000  # views along one side of a grid
_NUMBERS = (  # signs and decimals, as in coordinates; else digits alone
    re.compile(r"[+-]?[0-9]{1,20}(?:\.[0-9]{1,9})?(?![0-9]*\.[0-9])"),
    re.compile(r"[0-9]{1,20}"),
)


@attrs.frozen(kw_only=True)
class NumberedNames:
    """A family of names, and the meaning of their numbers."""

    views: dict[ViewIndex, str]  # names by (row, column) from (0, 0), or by (0, position)
    rows: int
    cols: int
    runs: bool  # whether one number runs


def side_of(stem: str) -> tuple[str, bool] | None:
    """(the rest of a name, whether it is the left view), by the last word for a side in it; None if
    there is none.
    """
    words = list(_SIDES.finditer(stem.lower().replace("_", " ")))
    if not words:
        return None
    rest = f"{stem[: words[-1].start()]}*{stem[words[-1].end() :]}".lower()
    return rest, words[-1][1].startswith("l")


def spaced(values: Collection[int]) -> tuple[int, int, int]:
    """The lowest of some numbers, their step (the greatest common divisor of the differences), and
    the number of values from the lowest to the highest in such steps.
    """
    low = min(values)
    step = math.gcd(*(value - low for value in values)) or 1
    return low, step, (max(values) - low) // step + 1


def placed(
    names: list[str], rows: list[int] | None, cols: list[int], shape: ViewIndex
) -> NumberedNames:
    """Names by grid index; the first of several for one index. rows: None for a running number."""
    views: dict[ViewIndex, str] = {}
    for name, index in zip(names, zip(rows or [0] * len(names), cols, strict=True), strict=True):
        views.setdefault(index, name)
    return NumberedNames(views=views, rows=shape[0], cols=shape[1], runs=rows is None)


def _value(text: str) -> int:
    """A number in units of 1e-9."""
    whole, _, decimals = text.partition(".")
    return int(whole + decimals.ljust(9, "0"))


def _column(texts: tuple[str, ...]) -> tuple[int, ...]:
    """One number of each name of a family; a sign that all of them have is a separator."""
    separator = all(text.startswith("-") for text in texts)
    return tuple(_value(text[separator:]) for text in texts)


def _indices(numbers: tuple[int, ...], most: float) -> tuple[list[int], int]:
    """(the index of each number in equal steps, the number of indices); by their order alone if
    there are more than `most` steps for a number.
    """
    values = sorted(set(numbers))
    low, step, count = spaced(values)
    if count > most * len(values):
        rank = {value: position for position, value in enumerate(values)}
        return [rank[number] for number in numbers], len(values)
    return [(number - low) // step for number in numbers], count


def _readings(
    names: list[str], columns: list[tuple[int, ...]]
) -> Iterator[tuple[NumberedNames, float]]:
    """Readings of a family's numbers: each two of them as row and column, and a running number; and
    the share of the indices that have a name, 0 if only the order of the numbers counts.
    """
    keys = [column for column in columns if len(set(column)) == len(names)]
    varying = [column for column in columns if 1 < len(set(column)) < len(names)]
    for pair in combinations(varying, 2):
        lattice = math.prod(len(set(column)) for column in pair)
        filled = len(set(zip(*pair, strict=True))) == len(names) == lattice
        (down, rows), (across, cols) = (_indices(n, 2 if filled else math.inf) for n in pair)
        if max(rows, cols) <= MAX_SIDE:
            numbered = placed(names, down, across, (rows, cols))
            yield numbered, len(numbered.views) / (rows * cols)
    if keys:
        key = min(keys, key=lambda key: spaced(key)[2])
        counted = 3 * spaced(key)[2] <= 4 * len(names)  # numbers with large gaps count nothing
        places, count = _indices(key, 4 / 3)
    else:  # all numbers together
        counted = False
        together = list(zip(*columns, strict=True))
        order = {numbers: position for position, numbers in enumerate(sorted(set(together)))}
        places, count = [order[numbers] for numbers in together], len(order)
    yield placed(names, None, places, (1, count)), counted * len(names) / count


def _families(stems: dict[str, str]) -> Iterator[tuple[tuple[float, float], NumberedNames]]:
    """Every reading of every large family, with its score: the number of names that it explains
    (names of maps and those of a run count less), then the share of the grid that is filled.
    """
    for pattern in _NUMBERS:
        families: defaultdict[tuple[str, ...], dict[str, tuple[str, ...]]] = defaultdict(dict)
        for name, stem in stems.items():
            numbers = tuple(pattern.findall(stem))
            if 0 < len(numbers) <= 12:  # a date with its time has six
                families[tuple(pattern.split(stem.lower()))][name] = numbers
        most = max((len(family) for family in families.values()), default=0)
        for texts, family in families.items():
            if len(family) < 2 or 2 * len(family) < most:
                continue
            maps = any(map(MAPS.search, texts))
            columns = [_column(texts) for texts in zip(*family.values(), strict=True)]
            for found, share in _readings(list(family), columns):
                weight = (_RUN if found.runs else 1) / (1 + maps)
                yield (len(found.views) * weight, share), found


@lru_cache(maxsize=4)
def read_names(names: tuple[str, ...]) -> NumberedNames | None:
    """The meaning of the numbers in most of these names; None if no two names differ in numbers
    alone.
    """
    found = list(_families({name: stem_of(name) for name in names}))
    return max(found, key=lambda one: one[0])[1] if found else None
