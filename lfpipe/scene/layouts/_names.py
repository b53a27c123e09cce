"""The numbers in the names of pictures: which two count rows and columns, which one runs, and which say nothing of the grid.

A name is split into texts and numbers; names with the same texts are a family. Two numbers count rows and columns where each
pair of values occurs once and the pairs fill a lattice; a number that differs in every name runs, or is a counter beside them.
"""

import math
import re
from collections import defaultdict
from collections.abc import Collection
from fractions import Fraction
from functools import lru_cache
from itertools import combinations

import attrs
import numpy as np

from lfpipe.scene.layouts._families import HALVES, LETTERS, MAPS, READINGS, Family, families_of
from lfpipe.scene.layouts._grid import MAX_SIDE
from lfpipe.scene.layouts._stems import stems_of
from lfpipe.scene.source import ViewIndex

_FRAME_WORDS = ("f", "fr", "frame", "frames", "time", "ev", "exp", "exposure", "iso", "take")  # numbers that count no views
_ROW_WORDS, _COL_WORDS = ("row", "rows", "r", "y", "v", "t"), ("col", "cols", "column", "c", "x", "u", "s")
_MIN_COVERAGE = 0.15  # of a lattice by files: less is no grid. A cross in a 13x13 grid has 0.148


@attrs.frozen
class Lattice:
    """Equally spaced values: low, low + step, ... (count of them). step 0: values in any distance, by their order."""

    low: Fraction
    step: Fraction
    count: int

    def index(self, value: Fraction) -> int:
        return int((value - self.low) / self.step)


@attrs.frozen
class NumberedNames:
    """A family of names by what their numbers say. views: names by (row, column) from (0, 0); or by (0, position) where one
    number runs (`runs`). clashes: pairs of names for one place. others: pictures that belong to another family. doubt: what the
    names leave open, "" for nothing."""

    views: dict[ViewIndex, str]
    rows: int
    cols: int
    runs: bool
    clashes: tuple[tuple[str, str], ...]
    others: tuple[str, ...]
    doubt: str = ""


def lattice(values: Collection[Fraction]) -> Lattice:
    """The finest lattice that holds the values."""
    low = min(values)
    scale = math.lcm(*(value.denominator for value in values))
    step = math.gcd(*(int((value - low) * scale) for value in values)) or scale
    return Lattice(low, Fraction(step, scale), int((max(values) - low) * scale) // step + 1)


def _word(text: str) -> str:
    """The word that a text ends in: "t" of "im_t"."""
    found = re.search(r"([a-z]+)[^a-z]*$", text)
    return found[1] if found else ""


def _read(family: Family) -> tuple[tuple[float, ...], NumberedNames] | None:
    """How well the numbers of a family make a grid or a run, and which; None where they do neither."""
    count, texts = len(family.names), family.texts
    values = [field_values for field_values, _ in family.numbers]
    varying = [field for field in range(len(values)) if len(values[field]) > 1]
    keys = [field for field in varying if len(values[field]) == count]
    if not keys and (frame := _one_frame(family, varying)) and (read := _read(frame[0])):
        return (float(count), 1.0, read[0][2]), attrs.evolve(read[1], doubt=frame[1])
    lattices = {field: lattice(values[field]) for field in varying}
    best: tuple[tuple[float, float, int, int], int, int] | None = None
    for first, second in combinations([field for field in varying if field not in keys], 2):
        pairs = family.distinct(first, second)
        if pairs == count == len(values[first]) * len(values[second]):  # a whole grid: of steps that are uneven, order counts
            for field in (first, second):
                if lattices[field].count > 2 * len(values[field]):
                    lattices[field] = Lattice(Fraction(-1), Fraction(0), len(values[field]))
        down, across = lattices[first], lattices[second]
        cells = down.count * across.count
        if max(down.count, across.count) > MAX_SIDE or count < _MIN_COVERAGE * cells:
            continue
        plain = sum(lat.step == 1 and lat.low in (0, 1) for lat in (down, across))
        rank = (pairs / count, pairs / cells, plain, -first - second)
        if pairs >= _MIN_COVERAGE * cells and (best is None or rank > best[0]):
            best = rank, first, second
    if best is not None and (best[0][0] > 0.9 or not keys):
        (_, share, _, _), first, second = best
        if _word(texts[first]) in _COL_WORDS and _word(texts[second]) in _ROW_WORDS:
            first, second = second, first
        return _placed(family, (lattices[first], first), (lattices[second], second), (1.0, share))
    if not keys and (count > 1 or not varying):
        # One number that occurs twice (view_1 and view_01), or a family of one name.
        keys = varying[-1:] or [len(values) - 1]
    if not keys:
        return None
    runs = {key: lattice(values[key]) for key in keys}
    field = min(keys, key=lambda key: (runs[key].count, -key))
    run = runs[field] if runs[field].count <= 2 * count + 2 else None  # else times, or numbers with large gaps
    return _placed(family, None, (run, field), (0.0, len(values[field]) / run.count if run else 0.0))


def _placed(
    family: Family, down: tuple[Lattice, int] | None, across: tuple[Lattice | None, int], rank: tuple[float, ...]
) -> tuple[tuple[float, ...], NumberedNames]:
    """(how many views and `rank`, the names by place): rows by one field, or none; columns by the lattice of another, or
    by the order of its values."""

    def indices(lat: Lattice | None, field: int) -> list[int]:
        values, codes = family.numbers[field]
        at = np.array([lat.index(value) for value in values] if lat and lat.step else range(len(values)))
        return list(at[codes].tolist())

    rows = indices(*down) if down else [0] * len(family.names)
    views: dict[ViewIndex, str] = {}
    clashes: list[tuple[str, str]] = []
    for name, index in zip(family.names, zip(rows, indices(*across), strict=True), strict=True):
        if index in views:
            clashes.append((views[index], name))
        else:
            views[index] = name
    cols = across[0].count if across[0] else len(family.numbers[across[1]][0])
    numbered = NumberedNames(views, down[0].count if down else 1, cols, down is None, tuple(clashes), ())
    return (len(views), *rank), numbered


def _one_frame(family: Family, varying: list[int]) -> tuple[Family, str] | None:
    """The names of the first frame where one number counts frames and the others are those of views, and what that leaves open;
    else None. Which one: by the word before it; of three, the one that is written unlike the other two."""

    def unlike(frame: int, fields: tuple[int, ...]) -> int:
        first, second = (field for field in fields if field != frame)
        low, digits = (family.numbers[first][0][0], family.numbers[second][0][0]), family.digits
        return (low[0] == low[1]) + (digits[first] == digits[second]) + (second == first + 1)

    for fields in [*combinations(varying, 3), *combinations(varying, 2)]:
        whole = math.prod(len(family.numbers[field][0]) for field in fields)
        if not whole == len(family.names) == family.distinct(*fields):
            continue
        named, doubt = [field for field in fields if _word(family.texts[field]) in _FRAME_WORDS], ""
        if len(fields) == 3 and not named:
            order = sorted(fields, key=lambda field: -unlike(field, fields))
            named = order[:1]
            if unlike(order[0], fields) == unlike(order[1], fields):
                doubt = "which of three numbers in the names counts frames"
        if named:
            first = np.flatnonzero(family.numbers[named[0]][1] == 0)
            numbers = [
                (values if field != named[0] else values[:1], codes[first])
                for field, (values, codes) in enumerate(family.numbers)
            ]
            return Family(family.texts, [family.names[k] for k in first], numbers, family.digits), doubt
    return None


def _contiguous(numbered: NumberedNames) -> bool:
    """Whether the numbers of a family that was read in halves just run on: 00 to 29 is no grid of 3x10."""
    numbers = [int(re.findall(r"[0-9]+", name.rpartition(".")[0])[-1]) for name in numbered.views.values()]
    return max(numbers) - min(numbers) < len(numbers)


def _by_folder(names: tuple[str, ...]) -> NumberedNames | None:
    """Rows by folder, columns by the order of names in each, where all folders hold equally many, two or more; else None."""
    folders: defaultdict[str, list[str]] = defaultdict(list)
    for name in names:
        folders[name.rpartition("/")[0]].append(name)
    counts = {len(inside) for inside in folders.values()}
    if len(folders) < 2 or len(counts) > 1 or counts == {1}:
        return None
    views = {(row, col): name for row, inside in enumerate(folders.values()) for col, name in enumerate(inside)}
    return NumberedNames(views, len(folders), counts.pop(), False, (), ())


@lru_cache(maxsize=4)
def read_names(names: tuple[str, ...]) -> NumberedNames | None:
    """What the numbers of most of these names say; None where no two names differ in numbers alone."""
    found: list[tuple[tuple[float, ...], NumberedNames]] = []
    stems = stems_of(names)
    for rank in range(len(READINGS)):
        families = families_of(stems, rank)
        most = max((len(family) for _, family in families), default=0)
        for texts, family in families:
            if len(family) > 1 and 2 * len(family) >= most and (read := _read(Family.of(texts, family))):
                key, numbered = read
                if rank == HALVES and (numbered.runs or key[2] < 1 or _contiguous(numbered)):
                    continue
                if rank == LETTERS and 2 * len(family) < len(names):  # Roman numerals, initials
                    continue
                views, lossless = not any(MAPS.search(text) for text in texts), texts[-2] != "jpg"
                if key[:3] == (len(names), 1.0, 1.0):
                    return _with_others(numbered, names)
                found.append(((key[0] * (1.0 if views else 0.5), *key[1:], views, lossless, -rank), numbered))
    best = max(found, key=lambda pair: pair[0])[1] if found else None
    if (best is None or best.runs or best.clashes) and (rows := _by_folder(names)) is not None:
        return rows
    return None if best is None else _with_others(best, names)


def _with_others(numbered: NumberedNames, names: tuple[str, ...]) -> NumberedNames:
    used = {*numbered.views.values(), *(name for clash in numbered.clashes for name in clash)}
    return attrs.evolve(numbered, others=tuple(name for name in names if name not in used))
