"""The numbers in the names of pictures: which two count rows and columns, which one runs, and which say nothing of the grid.

A name is split into texts and numbers; names with the same texts are a family. Two numbers count rows and columns where each
pair of values occurs once and the pairs fill a lattice; a number that differs in every name runs, or is a counter beside them.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Collection
from fractions import Fraction
from functools import lru_cache
from itertools import combinations

import attrs
import numpy as np
from numpy.typing import NDArray

from lfpipe.scene.layouts._grid import MAX_SIDE
from lfpipe.scene.source import ViewIndex

_SIGNED = r"(?<=[^0-9A-Za-z])[+-][0-9]{1,18}"
_DECIMAL = r"(?:\.[0-9]{1,9})?(?![0-9]*\.[0-9])"
# Ways to read numbers, the likeliest first: signs after a separator and decimals; signs anywhere; digits alone; letters count.
_READINGS = tuple(
    re.compile(pattern)
    for pattern in (
        rf"(?:{_SIGNED}|[0-9]{{1,18}}){_DECIMAL}",
        rf"[+-]?[0-9]{{1,18}}{_DECIMAL}",
        r"[0-9]{1,18}",
        r"[0-9]{1,18}|(?<![A-Za-z])[A-Za-z](?![A-Za-z])",
        r"[0-9]{1,18}",
    )
)
_HALVES = len(_READINGS) - 1  # the reading in which a number is row and column without a separator: 0307
_TIMES = (  # of day, as phones and messengers write them: behind a date, or with separators
    re.compile(r"(?<=\d{8}[-_])([01]\d|2[0-3])([0-5]\d)([0-5]\d)(?=\d{3}(?!\d)|\D|$)"),
    re.compile(r"(?<=[ _T])([01]\d|2[0-3])[.:_-]([0-5]\d)[.:_-]([0-5]\d)(?!\d)"),
)
_SUM = re.compile(r"[-_. ](?=[0-9a-f]*[a-f])(?=[0-9a-f]*[0-9])[0-9a-f]{6,40}$", re.IGNORECASE)
_SUM_OR_NUMBER = re.compile(r"[-_. ][0-9a-f]{6,40}$", re.IGNORECASE)
_COPY = re.compile(r"(.*?)([-_ ]?\(|[-_ ])(\d{1,5})(\)?)")
_SAME_KIND = {"jpeg": "jpg", "jpe": "jpg", "tiff": "tif"}
_FRAME_WORDS = ("f", "fr", "frame", "frames", "time")
_ROW_WORDS, _COL_WORDS = ("row", "rows", "r", "y", "v", "t"), ("col", "cols", "column", "c", "x", "u", "s")
MAPS = re.compile(r"depth|disp|mask|label|seg|normal|flow|conf|thumb|error|diff|gt", re.IGNORECASE)
_MIN_COVERAGE = 0.15  # of a lattice by files: less is no grid. A cross in a 13x13 grid has 0.148
_MAX_FIELDS = 12


@attrs.frozen
class Lattice:
    """Equally spaced values: low, low + step, ... (count of them)."""

    low: Fraction
    step: Fraction
    count: int

    def index(self, value: Fraction) -> int:
        return int((value - self.low) / self.step)


@attrs.frozen
class NumberedNames:
    """A family of names by what their numbers say. views: names by (row, column) from (0, 0); or by (0, position) where one
    number runs (`runs`). clashes: pairs of names for one place. others: pictures that belong to another family."""

    views: dict[ViewIndex, str]
    rows: int
    cols: int
    runs: bool
    clashes: tuple[tuple[str, str], ...]
    others: tuple[str, ...]


def lattice(values: Collection[Fraction]) -> Lattice:
    """The finest lattice that holds the values."""
    low = min(values)
    scale = math.lcm(*(value.denominator for value in values))
    step = math.gcd(*(int((value - low) * scale) for value in values)) or scale
    return Lattice(low, Fraction(step, scale), int((max(values) - low) * scale) // step + 1)


def _halves(number: str) -> list[str]:
    middle = len(number) // 2
    return [number] if len(number) % 2 else [number[:middle], number[middle:]]


def _value(text: str) -> Fraction:
    return Fraction(ord(text.lower()) - ord("a")) if text.isalpha() else Fraction(text)


@attrs.frozen(eq=False)
class _Family:
    """Names with the same texts. numbers: by field, the values that occur, ascending, and which of them each name has."""

    texts: tuple[str, ...]
    names: list[str]
    numbers: list[tuple[list[Fraction], NDArray[np.int64]]]

    @classmethod
    def of(cls, texts: tuple[str, ...], names: dict[str, tuple[str, ...]]) -> _Family:
        numbers = []
        for column in zip(*names.values(), strict=True):
            separator = all(text.startswith("-") for text in column)  # and no sign, where every number has it
            by_text = {text: _value(text[separator:]) for text in set(column)}
            values = sorted(set(by_text.values()))
            rank = {value: position for position, value in enumerate(values)}
            code = {text: rank[value] for text, value in by_text.items()}
            numbers.append((values, np.array([code[text] for text in column], np.int64)))
        return cls(texts, list(names), numbers)

    def distinct(self, *fields: int) -> int:
        """How many combinations of the values of these fields occur."""
        codes = np.zeros(len(self.names), np.int64)
        for field in fields:
            codes = codes * len(self.numbers[field][0]) + self.numbers[field][1]
        return len(np.unique(codes))


def _seconds(time: re.Match[str]) -> str:
    hours, minutes, seconds = map(int, time.groups())
    return f"{3600 * hours + 60 * minutes + seconds:05d}"


def _stems(names: tuple[str, ...]) -> dict[str, tuple[str, str]]:
    """The part of each name that is read, and its kind (jpg for .jpeg, too).

    Times of day are in seconds, sums at the end are left out, and the first of copies gets the number that it lacks: photo.jpg,
    photo (1).jpg, ... and shot.png, shot 2.png, ...
    """
    stems = {name: name.rpartition(".")[0] for name in names}
    for time in _TIMES:
        stems = {name: time.sub(_seconds, stem) for name, stem in stems.items()}
    if 2 * sum(_SUM.search(stem) is not None for stem in stems.values()) > len(names):
        stems = {name: _SUM_OR_NUMBER.sub("", stem) for name, stem in stems.items()}
    copies: defaultdict[str, list[tuple[int, str]]] = defaultdict(list)
    for stem in stems.values():
        if found := _COPY.fullmatch(stem):
            copies[found[1]].append((int(found[3]), stem))
    for name, stem in stems.items():
        first = min(copies.get(stem, [(0, "")]))
        if len(copies.get(stem, [])) > 1 and first[0] in (1, 2):
            stems[name] = _COPY.sub(rf"\g<1>\g<2>{first[0] - 1}\g<4>", first[1])
    suffixes = {name: name.rpartition(".")[2].lower() for name in names}
    return {name: (stem, _SAME_KIND.get(suffixes[name], suffixes[name])) for name, stem in stems.items()}


def _families(stems: dict[str, tuple[str, str]], rank: int) -> list[tuple[tuple[str, ...], dict[str, tuple[str, ...]]]]:
    """The texts of names, and the numbers of each name that has them. stems: as `_stems` gives them."""
    reading = _READINGS[rank]
    families: defaultdict[tuple[str, ...], dict[str, tuple[str, ...]]] = defaultdict(dict)
    for name, (stem, suffix) in stems.items():
        numbers, digits = reading.findall(stem), 0
        if rank == _HALVES and numbers:
            digits = len(numbers[-1])
            numbers = [*numbers[:-1], *_halves(numbers[-1])]
        if 0 < len(numbers) <= _MAX_FIELDS:
            texts = (*reading.split(stem.lower()), suffix, "0" * digits)
            families[texts][name] = tuple(numbers)
    return list(families.items())


def _word(text: str) -> str:
    """The word that a text ends in: "t" of "im_t"."""
    found = re.search(r"([a-z]+)[^a-z]*$", text)
    return found[1] if found else ""


def _read(family: _Family) -> tuple[tuple[float, ...], NumberedNames] | None:
    """How well the numbers of a family make a grid or a run, and which; None where they do neither."""
    count, texts = len(family.names), family.texts
    values = [field_values for field_values, _ in family.numbers]
    varying = [field for field in range(len(values)) if len(values[field]) > 1]
    keys = [field for field in varying if len(values[field]) == count]
    if not keys and (frame := _one_frame(family, varying)):
        return _read(frame)
    lattices = {field: lattice(values[field]) for field in varying}
    best: tuple[tuple[float, float, int, int], int, int] | None = None
    for first, second in combinations([field for field in varying if field not in keys], 2):
        down, across = lattices[first], lattices[second]
        cells = down.count * across.count
        if max(down.count, across.count) > MAX_SIDE or count < _MIN_COVERAGE * cells:
            continue
        pairs = family.distinct(first, second)
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
    family: _Family, down: tuple[Lattice, int] | None, across: tuple[Lattice | None, int], rank: tuple[float, ...]
) -> tuple[tuple[float, ...], NumberedNames]:
    """(how many views and `rank`, the names by place): rows by one field, or none; columns by the lattice of another, or
    by the order of its values."""

    def indices(lat: Lattice | None, field: int) -> list[int]:
        values, codes = family.numbers[field]
        at = np.array([lat.index(value) for value in values] if lat else range(len(values)))
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


def _one_frame(family: _Family, varying: list[int]) -> _Family | None:
    """The names of the first frame where three numbers count frames, rows and columns; else None."""
    for fields in combinations(varying, 3):
        if math.prod(len(family.numbers[field][0]) for field in fields) == len(family.names) == family.distinct(*fields):
            frame = next((field for field in fields if _word(family.texts[field]) in _FRAME_WORDS), fields[0])
            first = np.flatnonzero(family.numbers[frame][1] == 0)
            numbers = [
                (values if field != frame else values[:1], codes[first]) for field, (values, codes) in enumerate(family.numbers)
            ]
            return _Family(family.texts, [family.names[k] for k in first], numbers)
    return None


def _contiguous(numbered: NumberedNames) -> bool:
    """Whether the numbers of a family that was read in halves just run on: 00 to 29 is no grid of 3x10."""
    numbers = [int(re.findall(r"[0-9]+", name.rpartition(".")[0])[-1]) for name in numbered.views.values()]
    return max(numbers) - min(numbers) < len(numbers)


def _by_folder(names: tuple[str, ...]) -> NumberedNames | None:
    """Rows by folder, columns by the order of names in each, where all folders hold equally many; else None."""
    folders: defaultdict[str, list[str]] = defaultdict(list)
    for name in names:
        folders[name.rpartition("/")[0]].append(name)
    counts = {len(inside) for inside in folders.values()}
    if len(folders) < 2 or len(counts) > 1:
        return None
    views = {(row, col): name for row, inside in enumerate(folders.values()) for col, name in enumerate(inside)}
    return NumberedNames(views, len(folders), counts.pop(), False, (), ())


@lru_cache(maxsize=4)
def read_names(names: tuple[str, ...]) -> NumberedNames | None:
    """What the numbers of most of these names say; None where no two names differ in numbers alone."""
    found: list[tuple[tuple[float, ...], NumberedNames]] = []
    stems = _stems(names)
    for rank in range(len(_READINGS)):
        families = _families(stems, rank)
        most = max((len(family) for _, family in families), default=0)
        for texts, family in families:
            if len(family) > 1 and 2 * len(family) >= most and (read := _read(_Family.of(texts, family))):
                key, numbered = read
                if rank == _HALVES and (numbered.runs or key[2] < 1 or _contiguous(numbered)):
                    continue
                views = not any(MAPS.search(text) for text in texts)
                if key[:3] == (len(names), 1.0, 1.0):
                    return numbered
                found.append(((key[0] * (1.0 if views else 0.5), *key[1:], views, -rank), numbered))
    best = max(found, key=lambda pair: pair[0])[1] if found else None
    if (best is None or best.runs or best.clashes) and (rows := _by_folder(names)) is not None:
        return rows
    if best is None:
        return None
    used = {*best.views.values(), *(name for clash in best.clashes for name in clash)}
    return attrs.evolve(best, others=tuple(name for name in names if name not in used))
