"""Interprets the numbers in the names of pictures: row and column, or a running number.
docs/layouts.md states the rules.

A name is split into texts and numbers; names with the same texts form a family. Two numbers are row
and column if each pair of values occurs once and the pairs fill a lattice. A number that differs in
every name is a running number, or an additional counter.
"""

import math
import re
from collections import defaultdict
from collections.abc import Collection, Iterator
from functools import cached_property, lru_cache
from itertools import combinations

import attrs

from lfpipe.scene.files import stem_of
from lfpipe.scene.layouts._candidates import Candidate, ranked
from lfpipe.scene.source import ViewIndex

_SIGNED = r"(?<=[^0-9A-Za-z])[+-][0-9]{1,20}"
_DECIMAL = r"(?:\.[0-9]{1,9})?(?![0-9]*\.[0-9])"
MAPS = re.compile(
    r"depth|disp|mask|matte|alpha|label|seg|normal|flow(?!er)|conf(?!e)|thumb|error|diff"
    r"|(?<![a-z])gt|(?<![a-z])class(es)?(?![a-z])",
    re.IGNORECASE,
)
# Names of left and right, by language.
LEFT = ("left", "l", "links", "gauche", "izquierda", "sinistra")
RIGHT = ("right", "r", "rechts", "droite", "derecha", "destra")
SIDES = re.compile(rf"(?<![a-z])({'|'.join(LEFT + RIGHT)})(?![a-z])")
# words before numbers that do not count views
_FRAME_WORDS = ("f", "fr", "frame", "frames", "time", "ev", "exp", "exposure", "iso", "take")
_RUN = 0.9  # score of a name in a run; 1 in a grid
_WHOLE = 0.2  # added to the score of a grid without gaps; less with gaps
_PLAIN = 0.002  # added to the score of a grid whose numbers count from 0 or 1 in steps of 1
_CLEAR = 0.001  # lead over the second-best score that is unambiguous
_UNIT = 10**9  # fixed-point scale of numbers, which have up to nine decimals
MAX_SIDE = 10_000  # views along one side of a grid


_COPY = re.compile(r"(.*?)([-_ ]?\(|[-_ ])(\d{1,5})(\)?)", re.DOTALL)


@attrs.frozen(kw_only=True)
class NumberedNames:
    """A family of names, and the meaning of their numbers."""

    views: dict[ViewIndex, str]  # names by (row, column) from (0, 0), or by (0, position)
    rows: int
    cols: int
    runs: bool  # whether one number runs
    clashes: tuple[tuple[str, str], ...] = ()  # pairs of names for one grid index
    doubt: str = ""  # what the names leave ambiguous, "" for nothing
    explained: int = 0  # number of names with a grid index, or with another frame of an index
    share: float = 0.0  # share of the grid that has names


def side_of(stem: str) -> tuple[str, bool] | None:
    """(the rest of a name, whether it is the left view), by the last word for a side in it; None if
    there is none.
    """
    words = list(SIDES.finditer(stem.lower().replace("_", " ")))
    if not words:
        return None
    return f"{stem[: words[-1].start()]}*{stem[words[-1].end() :]}".lower(), words[-1][1] in LEFT


def spaced(values: Collection[int]) -> tuple[int, int, int]:
    """The lowest of some numbers, their step (the greatest common divisor of the differences), and
    the number of values from the lowest to the highest in such steps.
    """
    low = min(values)
    step = math.gcd(*(value - low for value in values)) or 1
    return low, step, (max(values) - low) // step + 1


@attrs.frozen(slots=False)
class _Column:
    """One number of a family's names."""

    numbers: tuple[int, ...]  # by name, in units of 1e-9
    word: str  # the letters before it

    @classmethod
    def of(cls, texts: tuple[str, ...], before: str) -> "_Column":
        # without the sign if every number has it
        separator = all(text.startswith("-") for text in texts)
        word = re.search(r"([a-z]+)[^a-z]*$", before)
        return cls(tuple(_value(text[separator:]) for text in texts), word[1] if word else "")

    @cached_property
    def values(self) -> list[int]:
        """The numbers that occur, ascending."""
        return sorted(set(self.numbers))

    @cached_property
    def steps(self) -> tuple[int, int, int]:
        return spaced(self.values)

    @property
    def count(self) -> int:
        """The number of values from the lowest to the highest in equal steps."""
        return self.steps[2]

    @property
    def places(self) -> list[int]:
        """By name, the index of its number in equal steps."""
        low, step, _ = self.steps
        return [(number - low) // step for number in self.numbers]

    def ordered(self) -> "_Column":
        """The column with the ranks of its numbers instead of the numbers: without gaps."""
        order = {value: position * _UNIT for position, value in enumerate(self.values)}
        return attrs.evolve(self, numbers=tuple(order[number] for number in self.numbers))


def _value(text: str) -> int:
    """A number in units of 1e-9; for a letter, its index in the alphabet."""
    if text.isalpha():
        return _UNIT * (ord(text.lower()) - ord("a"))
    whole, _, decimals = text.partition(".")
    return int(whole + decimals.ljust(9, "0"))


_READINGS = {  # patterns of the numbers in names, the likeliest first
    "signs after a separator": re.compile(rf"(?:{_SIGNED}|[0-9]{{1,20}}){_DECIMAL}"),
    "signs anywhere": re.compile(rf"[+-]?[0-9]{{1,20}}{_DECIMAL}"),
    "digits alone": re.compile(r"[0-9]{1,20}"),
    "single letters": re.compile(r"[0-9]{1,20}|(?<![A-Za-z])[A-Za-z](?![A-Za-z])"),
}


def _stems(names: tuple[str, ...]) -> dict[str, str]:
    """Names without suffixes; the unnumbered original of numbered copies gets a number."""
    stems = {name: stem_of(name) for name in names}
    copies: defaultdict[str, list[tuple[int, str]]] = defaultdict(list)
    for stem in stems.values():
        if match := _COPY.fullmatch(stem):
            copies[match[1]].append((int(match[3]), stem))
    for name, stem in stems.items():  # photo.jpg, photo (1).jpg, ...; shot.png, shot 2.png, ...
        first = min(copies.get(stem, [(0, "")]))
        if len(copies.get(stem, [])) > 1 and first[0] in (1, 2):
            stems[name] = _COPY.sub(rf"\g<1>\g<2>{first[0] - 1}\g<4>", first[1])
    return stems


def _families(
    stems: dict[str, str], pattern: re.Pattern[str]
) -> dict[tuple[str, ...], dict[str, tuple[str, ...]]]:
    """The names of each family and the numbers of each name, by the family's texts."""
    families: defaultdict[tuple[str, ...], dict[str, tuple[str, ...]]] = defaultdict(dict)
    for name, stem in stems.items():
        numbers = tuple(pattern.findall(stem))
        if 0 < len(numbers) <= 12:  # a date with its time has six
            families[tuple(pattern.split(stem.lower()))][name] = numbers
    return families


def _together(columns: Collection[_Column]) -> list[tuple[int, ...]]:
    """The numbers in these columns, by name."""
    return list(zip(*(column.numbers for column in columns), strict=True))


def _way(numbered: NumberedNames, order: float = 0.0, frames: int = 1) -> Candidate[NumberedNames]:
    """An interpretation with its score: the number of explained names (those of a run count less,
    so that a grid of nearly all names beats it), then the share of the grid that is filled, then
    `order`.
    """
    shape = f"a run of {numbered.cols}" if numbered.runs else f"{numbered.rows}x{numbered.cols}"
    return Candidate(
        what=shape + f" with {frames} frames" * (frames > 1),
        score=numbered.explained * (_RUN if numbered.runs else 1) + _WHOLE * numbered.share + order,
        value=numbered,
        measures={
            "names explained": numbered.explained,
            "indices with a name": numbered.share,
            "clashes": len(numbered.clashes),
        },
    )


def _ways(names: list[str], columns: list[_Column]) -> list[Candidate[NumberedNames]]:
    """Interpretations of a family's numbers, the likeliest first. If the second one is equally
    likely, the first one reports the ambiguity.
    """
    varying = [column for column in columns if len(column.values) > 1]
    keys = [column for column in varying if len(column.values) == len(names)]
    frames = [] if keys else _frame_columns(varying, len(names))
    ways = [way for column in frames for way in _without_frames(names, column, varying)]
    if len(frames) != 1:
        ways += _grids(names, [column for column in varying if column not in keys])
    if keys:
        column = min(keys, key=lambda key: key.count)
        counts = 3 * column.count <= 4 * len(names)  # numbers with large gaps count nothing
        places = column.places if counts else column.ordered().places
        ways.append(_way(placed(names, None, places, (1, max(places) + 1), counts)))
    if not ways:  # all numbers together form a running number
        together = _together(varying) or [()] * len(names)
        order = {numbers: position for position, numbers in enumerate(sorted(set(together)))}
        places = [order[numbers] for numbers in together]
        ways.append(_way(placed(names, None, places, (1, len(order)), counts=False)))
    best, *others = sorted(ways, key=lambda way: -way.score)
    near = [
        way.what
        for way in others
        if way.score > best.score - _CLEAR and way.value.views != best.value.views
    ]
    if near:
        best = attrs.evolve(
            best,
            value=attrs.evolve(
                best.value,
                doubt=f"the meaning of the numbers in the names: {best.what}, or {near[0]}",
            ),
        )
    return [best, *others]


def _grids(names: list[str], columns: list[_Column]) -> Iterator[Candidate[NumberedNames]]:
    """Interpretations with two numbers as row and column."""
    for down, across in combinations(columns, 2):
        plain = all(column.steps[:2] in ((0, _UNIT), (_UNIT, _UNIT)) for column in (down, across))
        pairs = len(set(_together((down, across))))
        if pairs == len(names) == len(down.values) * len(across.values):
            # then the order decides if steps are uneven
            down, across = (
                column.ordered() if column.count > 2 * len(column.values) else column
                for column in (down, across)
            )
        if max(down.count, across.count) > MAX_SIDE:
            continue
        yield _way(
            placed(names, down.places, across.places, (down.count, across.count)),
            _PLAIN * plain,
        )


def _without_frames(
    names: list[str], frames: _Column, columns: list[_Column]
) -> Iterator[Candidate[NumberedNames]]:
    """Interpretations of the other numbers, by the names of the first frame."""
    first = [at for at, number in enumerate(frames.numbers) if number == frames.values[0]]
    kept = [
        attrs.evolve(column, numbers=tuple(column.numbers[at] for at in first))
        for column in columns
        if column != frames
    ]
    for way in _ways([names[at] for at in first], kept):
        numbered = attrs.evolve(way.value, explained=len(names))
        yield _way(numbered, _PLAIN * (frames.word in _FRAME_WORDS), len(frames.values))


def placed(
    names: list[str], rows: list[int] | None, cols: list[int], shape: ViewIndex, counts: bool = True
) -> NumberedNames:
    """Names by grid index; the first of several for one index. rows: None for a running number;
    counts: whether the numbers themselves are indices, not only their order.
    """
    views: dict[ViewIndex, str] = {}
    clashes: list[tuple[str, str]] = []
    for name, index in zip(names, zip(rows or [0] * len(names), cols, strict=True), strict=True):
        if index in views:
            clashes.append((views[index], name))
        else:
            views[index] = name
    return NumberedNames(
        views=views,
        rows=shape[0],
        cols=shape[1],
        runs=rows is None,
        clashes=tuple(clashes),
        explained=len(views),
        share=len(views) / (shape[0] * shape[1]) if counts else 0.0,
    )


def _frame_columns(varying: list[_Column], count: int) -> list[_Column]:
    """The numbers that may count frames or exposures, if they and those of views fill a cuboid: the
    one after such a word, else each of three.
    """
    for columns in [*combinations(varying, 3), *combinations(varying, 2)]:
        whole = math.prod(len(column.values) for column in columns)
        if whole == count == len(set(_together(columns))):
            named = [column for column in columns if column.word in _FRAME_WORDS]
            if named or len(columns) == 3:
                return named[:1] or list(reversed(columns))
    return []


def _candidates(names: tuple[str, ...]) -> Iterator[Candidate[NumberedNames]]:
    """Every family in each reading; stops when no better one is possible."""
    stems = _stems(names)
    for reading, pattern in _READINGS.items():
        families = _families(stems, pattern)
        most = max((len(family) for family in families.values()), default=0)
        if reading == "single letters" and 2 * most < len(names):  # Roman numerals, or initials
            return
        for texts, family in families.items():
            if len(family) < 2 or 2 * len(family) < most:
                continue
            fields = zip(zip(*family.values(), strict=True), texts, strict=False)
            columns = [_Column.of(numbers, before) for numbers, before in fields]
            maps = any(MAPS.search(text) for text in texts)
            ways = [
                attrs.evolve(
                    way,
                    what=f"{'#'.join(texts)}: {reading}, {way.what}",
                    score=way.score / (1 + maps),
                )
                for way in _ways(list(family), columns)
            ]
            yield from ways
            if ways[0].score >= len(names) + _WHOLE:
                return


@lru_cache(maxsize=4)
def read_names(names: tuple[str, ...]) -> NumberedNames | None:
    """The meaning of the numbers in most of these names; None if no two names differ in numbers
    alone.
    """
    order = ranked(f"the numbers in {len(names)} names", list(_candidates(names)))
    return order[0].value if order else None
