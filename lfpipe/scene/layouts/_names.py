"""The numbers in the names of pictures: which two count rows and columns, which one runs. docs/layouts.md states the rules.

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
from numpy.typing import NDArray

from lfpipe.scene.source import ViewIndex

_SIGNED = r"(?<=[^0-9A-Za-z])[+-][0-9]{1,18}"
_DECIMAL = r"(?:\.[0-9]{1,9})?(?![0-9]*\.[0-9])"
# Ways to read numbers, the likeliest first: signs after a separator and decimals; signs anywhere; digits alone; letters count;
# row and column in one number without a separator (0307).
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
_LETTERS, _HALVES = len(_READINGS) - 2, len(_READINGS) - 1
MAPS = re.compile(
    r"depth|disp|mask|matte|alpha|label|seg|normal|flow(?!er)|conf(?!e)|thumb|error|diff|(?<![a-z])gt", re.IGNORECASE
)
# Names of the two eyes' pictures, by language.
LEFT, RIGHT = ("left", "l", "links", "gauche", "izquierda", "sinistra"), ("right", "r", "rechts", "droite", "derecha", "destra")
_FRAME_WORDS = ("f", "fr", "frame", "frames", "time", "ev", "exp", "exposure", "iso", "take")  # numbers that count no views
_ROW_WORDS, _COL_WORDS = ("row", "rows", "r", "y", "v", "t"), ("col", "cols", "column", "c", "x", "u", "s")
_MIN_COVERAGE = 0.15  # of a lattice by files: less is no grid. A cross in a 13x13 grid has 0.148
_MAX_FIELDS = 12
MAX_SIDE = 10_000  # views along one side of a grid
_TIME = re.compile(r"(?:19|20)\d\d([-_.]?)[01]\d\1[0-3]\d\D{0,4}[0-2]\d([-_.:]?)[0-5]\d\2[0-5]\d(?:\d{3}(?!\d))?(?!\d)")
_SUM = re.compile(r"[-_. ](?=[0-9a-f]*[a-f])(?=[0-9a-f]*[0-9])[0-9a-f]{6,40}$", re.IGNORECASE)
_SUM_OR_NUMBER = re.compile(r"[-_. ][0-9a-f]{6,40}$", re.IGNORECASE)
_COPY = re.compile(r"(.*?)([-_ ]?\(|[-_ ])(\d{1,5})(\)?)", re.DOTALL)


@attrs.frozen
class NumberedNames:
    """A family of names by what their numbers say. views: names by (row, column) from (0, 0); or by (0, position) where one
    number runs (`runs`). clashes: pairs of names for one place. doubt: what the names leave open, "" for nothing."""

    views: dict[ViewIndex, str]
    rows: int
    cols: int
    runs: bool
    clashes: tuple[tuple[str, str], ...] = ()
    doubt: str = ""


# How well numbers explain names; the largest wins: names explained, halved for maps; whether they are a grid; the share of its
# places that have a name; of the ways to read numbers, the likeliest.
_Fit = tuple[float, bool, float, int]


@attrs.frozen
class Lattice:
    """Equally spaced values: low, low + step, ... (count of them)."""

    low: Fraction
    step: Fraction
    count: int

    @classmethod
    def of(cls, values: Collection[Fraction]) -> "Lattice":
        """The finest lattice that holds the values."""
        low = min(values)
        scale = math.lcm(*(value.denominator for value in values))
        step = math.gcd(*(int((value - low) * scale) for value in values)) or scale
        return cls(low, Fraction(step, scale), int((max(values) - low) * scale) // step + 1)

    def index(self, value: Fraction) -> int:
        """The place of a value that it holds."""
        return int((value - self.low) / self.step)


@attrs.frozen(eq=False)
class _Field:
    """One number of a family's names. values: those that occur, ascending; codes: by name, which of them it has; word: the text
    before it ends in; lattice: of the values."""

    values: list[Fraction]
    codes: NDArray[np.int64]
    word: str
    lattice: Lattice

    @classmethod
    def of(cls, column: tuple[str, ...], text: str) -> "_Field":
        separator = all(number.startswith("-") for number in column)  # and no sign, where every number has it
        by_text = {number: _value(number[separator:]) for number in set(column)}
        values = sorted(set(by_text.values()))
        rank = {value: position for position, value in enumerate(values)}
        word = re.search(r"([a-z]+)[^a-z]*$", text)
        codes = np.array([rank[by_text[number]] for number in column], np.int64)
        return cls(values, codes, word[1] if word else "", Lattice.of(values))

    def indices(self, by_order: bool = False) -> list[int]:
        """By name, the place of its value in the lattice, or in the order of values."""
        at = list(range(len(self.values))) if by_order else [self.lattice.index(value) for value in self.values]
        return [at[code] for code in self.codes.tolist()]

    def side(self, by_order: bool) -> int:
        """How many places there are."""
        return len(self.values) if by_order else self.lattice.count


def _value(text: str) -> Fraction:
    return Fraction(ord(text.lower()) - ord("a")) if text.isalpha() else Fraction(text)


def _stems(names: tuple[str, ...]) -> dict[str, str]:
    """The part of each name that is read: without suffix and sums, times in order, and the first of copies numbered."""
    stems = {name: name.rpartition(".")[0] for name in names}
    times = {name: match[0] for name, stem in stems.items() if (match := _TIME.search(stem))}
    if 2 * len(times) > len(names):  # a time counts nothing: it puts names in order
        order = {time: f"{position:05d}" for position, time in enumerate(sorted(set(times.values())))}
        stems |= {name: stems[name].replace(time, order[time], 1) for name, time in times.items()}
    if 2 * sum(_SUM.search(stem) is not None for stem in stems.values()) > len(names):
        stems = {name: _SUM_OR_NUMBER.sub("", stem) for name, stem in stems.items()}
    copies: defaultdict[str, list[tuple[int, str]]] = defaultdict(list)
    for stem in stems.values():
        if match := _COPY.fullmatch(stem):
            copies[match[1]].append((int(match[3]), stem))
    for name, stem in stems.items():  # photo.jpg, photo (1).jpg, ...; shot.png, shot 2.png, ...
        first = min(copies.get(stem, [(0, "")]))
        if len(copies.get(stem, [])) > 1 and first[0] in (1, 2):
            stems[name] = _COPY.sub(rf"\g<1>\g<2>{first[0] - 1}\g<4>", first[1])
    return stems


def _families(stems: dict[str, str], reading: int) -> dict[tuple[str, ...], dict[str, tuple[str, ...]]]:
    """By their texts, the names of each family and the numbers of each name."""
    families: defaultdict[tuple[str, ...], dict[str, tuple[str, ...]]] = defaultdict(dict)
    for name, stem in stems.items():
        numbers, digits = _READINGS[reading].findall(stem), 0
        if reading == _HALVES and numbers and len(numbers[-1]) % 2 == 0:
            digits = len(numbers[-1])
            numbers[-1:] = numbers[-1][: digits // 2], numbers[-1][digits // 2 :]
        if 0 < len(numbers) <= _MAX_FIELDS:
            families[*_READINGS[reading].split(stem.lower()), "0" * digits][name] = tuple(numbers)
    return families


def _together(fields: Collection[_Field]) -> list[tuple[int, ...]]:
    """By name, the codes of these fields."""
    return list(zip(*(field.codes.tolist() for field in fields), strict=True))


def _read(names: list[str], fields: list[_Field]) -> tuple[_Fit, NumberedNames]:
    """What the numbers of a family say."""
    count = len(names)
    varying = [field for field in fields if len(field.values) > 1]
    keys = [field for field in varying if len(field.values) == count]
    if not keys and (frame := _frame_field(varying, count)):
        field, doubt = frame
        first = np.flatnonzero(field.codes == 0).tolist()
        kept = [attrs.evolve(other, codes=other.codes[first]) for other in varying if other is not field]
        fit, numbered = _read([names[k] for k in first], kept)
        return (count, *fit[1:]), attrs.evolve(numbered, doubt=doubt)
    grid = _grid_fields([field for field in varying if field not in keys], count)
    if grid is not None and (grid[0] > 0.9 * count or not keys):
        _, share, axes = grid
        down, across = (field.indices(by_order) for field, by_order in axes)
        rows, cols = (field.side(by_order) for field, by_order in axes)
        numbered = _placed(names, down, across, (rows, cols))
        return (len(numbered.views), True, share, 0), numbered
    if keys:
        field = min(keys, key=lambda key: key.lattice.count)
        by_order = 3 * field.lattice.count > 4 * count  # numbers with large gaps count nothing
        share = 0.0 if by_order else count / field.lattice.count
        return (count, False, share, 0), _placed(names, None, field.indices(by_order), (1, field.side(by_order)))
    places = _together(varying) or [()] * count  # the numbers together run
    at = {place: position for position, place in enumerate(sorted(set(places)))}
    numbered = _placed(names, None, [at[place] for place in places], (1, len(at)))
    return (len(numbered.views), False, 0.0, 0), numbered


_Axes = tuple[tuple[_Field, bool], tuple[_Field, bool]]


def _grid_fields(fields: list[_Field], count: int) -> tuple[int, float, _Axes] | None:
    """How many pairs occur of the two numbers that count rows and columns, the share of the grid's places that they are, and the
    numbers, each with whether its values count by their order; None if there are none."""
    best: tuple[tuple[float, float, bool, int], tuple[int, float, _Axes]] | None = None
    for (first, down), (second, across) in combinations(enumerate(fields), 2):
        pairs = len(set(_together((down, across))))
        whole = pairs == count == len(down.values) * len(across.values)  # then order counts where steps are uneven
        axes = tuple((field, whole and field.lattice.count > 2 * len(field.values)) for field in (down, across))
        sides = [field.side(by_order) for field, by_order in axes]
        cells = sides[0] * sides[1]
        if max(sides) > MAX_SIDE or pairs < _MIN_COVERAGE * cells:
            continue
        plain = all(not by_order and field.lattice.step == 1 and field.lattice.low in (0, 1) for field, by_order in axes)
        rank = (pairs / count, pairs / cells, plain, -first - second)
        if best is None or rank > best[0]:
            swapped = down.word in _COL_WORDS and across.word in _ROW_WORDS
            best = rank, (pairs, pairs / cells, axes[::-1] if swapped else axes)  # type: ignore[assignment]
    return best and best[1]


def _placed(names: list[str], rows: list[int] | None, cols: list[int], shape: ViewIndex) -> NumberedNames:
    views: dict[ViewIndex, str] = {}
    clashes: list[tuple[str, str]] = []
    for name, index in zip(names, zip(rows or [0] * len(names), cols, strict=True), strict=True):
        if index in views:
            clashes.append((views[index], name))
        else:
            views[index] = name
    return NumberedNames(views, *shape, rows is None, tuple(clashes))


def _frame_field(varying: list[_Field], count: int) -> tuple[_Field, str] | None:
    """The number that counts frames or exposures, and what that leaves open, where the numbers of views and it fill a box: by the
    word before it, else the last of three."""
    for fields in [*combinations(varying, 3), *combinations(varying, 2)]:
        if math.prod(len(field.values) for field in fields) == count == len(set(_together(fields))):
            named = next((field for field in fields if field.word in _FRAME_WORDS), None)
            if named is not None:
                return named, ""
            if len(fields) == 3:
                return fields[2], "which of three numbers in the names counts frames"
    return None


def _runs_on(numbered: NumberedNames) -> bool:
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
    return NumberedNames(views, len(folders), counts.pop(), False)


@lru_cache(maxsize=4)
def read_names(names: tuple[str, ...]) -> NumberedNames | None:
    """What the numbers of most of these names say; None where no two names differ in numbers alone."""
    best: tuple[_Fit, NumberedNames | None] = (0, False, 0.0, -len(_READINGS)), None
    stems = _stems(names)
    for reading in range(len(_READINGS)):
        families = _families(stems, reading)
        most = max((len(family) for family in families.values()), default=0)
        for texts, family in families.items():
            if len(family) < 2 or 2 * len(family) < most:
                continue
            fields = [_Field.of(column, text) for column, text in zip(zip(*family.values(), strict=True), texts, strict=False)]
            (views, grid, share, _), numbered = _read(list(family), fields)
            if reading == _HALVES and (numbered.runs or share < 1 or _runs_on(numbered)):
                continue
            if reading == _LETTERS and 2 * len(family) < len(names):  # Roman numerals, initials
                continue
            if (views, grid, share) == (len(names), True, 1.0):
                return numbered
            maps = any(MAPS.search(text) for text in texts)
            fit = views / (1 + maps), grid, share, -reading
            if fit > best[0]:
                best = fit, numbered
    chosen = best[1]
    if (chosen is None or chosen.runs or chosen.clashes) and (rows := _by_folder(names)) is not None:
        return rows
    return chosen
