"""The numbers in the names of pictures: which two count rows and columns, which one runs.
docs/layouts.md states the rules.

A name is split into texts and numbers; names with the same texts are a family. Two numbers count
rows and columns where each pair of values occurs once and the pairs fill a lattice; a number that
differs in every name runs, or is a counter beside them.
"""

import math
import re
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from functools import cached_property, lru_cache
from itertools import combinations

import attrs

from lfpipe.scene.layouts._candidates import Candidate, ranked
from lfpipe.scene.source import ViewIndex

_SIGNED = r"(?<=[^0-9A-Za-z])[+-][0-9]{1,18}"
_DECIMAL = r"(?:\.[0-9]{1,9})?(?![0-9]*\.[0-9])"
MAPS = re.compile(
    r"depth|disp|mask|matte|alpha|label|seg|normal|flow(?!er)|conf(?!e)|thumb|error|diff"
    r"|(?<![a-z])gt|(?<![a-z])class(es)?(?![a-z])",
    re.IGNORECASE,
)
# Names of the two eyes' pictures, by language.
LEFT = ("left", "l", "links", "gauche", "izquierda", "sinistra")
RIGHT = ("right", "r", "rechts", "droite", "derecha", "destra")
SIDES = re.compile(rf"(?<![a-z])({'|'.join(LEFT + RIGHT)})(?![a-z])")
# numbers that count no views
_FRAME_WORDS = ("f", "fr", "frame", "frames", "time", "ev", "exp", "exposure", "iso", "take")
_ROW_WORDS = ("row", "rows", "r", "y", "v", "t")
_COL_WORDS = ("col", "cols", "column", "c", "x", "u", "s")
_MIN_COVERAGE = 0.15  # of a lattice by files: less is no grid. A cross in a 13x13 grid has 0.148
# Of scores: a name of a run, against 1 of a grid; a grid without gaps. Among equals: numbers from 0
# or 1 in steps of 1, or after a word; less for numbers further behind, and for a later reading
_RUN, _WHOLE = 0.9, 0.2
_PLAIN, _LATER, _NEXT_READING = 0.002, 1e-5, 0.003
_CLEAR = 0.001  # lead of a score on the next one that leaves no doubt
_MAX_FIELDS = 12  # a date with its time has six
_UNIT = 10**9  # of numbers, which have up to nine decimals
MAX_SIDE = 10_000  # views along one side of a grid
_TIME = re.compile(
    r"(?:19|20)\d\d([-_.]?)[01]\d\1[0-3]\d\D{0,4}"
    r"[0-2]\d([-_.:]?)[0-5]\d\2[0-5]\d(?:\d{3}(?!\d))?(?!\d)"
)
_SUM = re.compile(r"[-_. ](?=[0-9a-f]*[a-f])(?=[0-9a-f]*[0-9])[0-9a-f]{6,40}$", re.IGNORECASE)
_SUM_OR_NUMBER = re.compile(r"[-_. ][0-9a-f]{6,40}$", re.IGNORECASE)
_COPY = re.compile(r"(.*?)([-_ ]?\(|[-_ ])(\d{1,5})(\)?)", re.DOTALL)


@attrs.frozen(kw_only=True)
class NumberedNames:
    """A family of names by what their numbers say."""

    views: dict[ViewIndex, str]  # names by (row, column) from (0, 0), or by (0, position)
    rows: int
    cols: int
    runs: bool  # whether one number runs
    clashes: tuple[tuple[str, str], ...] = ()  # pairs of names for one place
    doubt: str = ""  # what the names leave open, "" for nothing
    explained: int = 0  # how many names have a place, or another frame of it
    share: float = 0.0  # of all places, those that have a name


def side_of(stem: str) -> tuple[str, bool] | None:
    """(the rest of a name, whether it is the left eye's) by its last word for a side; None without
    one.
    """
    words = list(SIDES.finditer(stem.lower().replace("_", " ")))
    if not words:
        return None
    return f"{stem[: words[-1].start()]}*{stem[words[-1].end() :]}".lower(), words[-1][1] in LEFT


def spaced(values: Collection[int]) -> tuple[int, int, int]:
    """The lowest of some numbers, their step (the largest that leads to all of them), and how many
    such steps there are, with the first.
    """
    low = min(values)
    step = math.gcd(*(value - low for value in values)) or 1
    return low, step, (max(values) - low) // step + 1


@attrs.frozen(slots=False)
class _Column:
    """One number of a family's names, in units of 1e-9. word: the letters before it."""

    numbers: tuple[int, ...]
    word: str

    @classmethod
    def of(cls, texts: tuple[str, ...], before: str) -> "_Column":
        # and no sign, where every number has it
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
        """How many places there are in equal steps."""
        return self.steps[2]

    @property
    def places(self) -> list[int]:
        """By name, the place of its number."""
        low, step, _ = self.steps
        return [(number - low) // step for number in self.numbers]

    def ordered(self) -> "_Column":
        """The order of the numbers in their place: without gaps."""
        order = {value: position * _UNIT for position, value in enumerate(self.values)}
        return attrs.evolve(self, numbers=tuple(order[number] for number in self.numbers))


def _value(text: str) -> int:
    """A number in units of 1e-9; of a letter, its place in the alphabet."""
    if text.isalpha():
        return _UNIT * (ord(text.lower()) - ord("a"))
    whole, _, decimals = text.partition(".")
    return int(whole + decimals.ljust(9, "0"))


def _stems(names: tuple[str, ...]) -> dict[str, str]:
    """The part of each name that is read: without suffix and sums, times in order, and the first of
    copies numbered.
    """
    stems = {name: name.rpartition(".")[0] for name in names}
    times = {name: match[0] for name, stem in stems.items() if (match := _TIME.search(stem))}
    if 2 * len(times) > len(names):  # a time counts nothing: it puts names in order
        order = {
            time: f"{position:05d}" for position, time in enumerate(sorted(set(times.values())))
        }
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


@attrs.frozen(kw_only=True)
class _Reading:
    """A way to find the numbers in names."""

    name: str
    pattern: re.Pattern[str]
    halved: bool = False  # the last number is row and column without a separator (0307)
    # whether a family that was read so counts, of so many names
    accepts: Callable[[NumberedNames, int, int], bool] = lambda numbered, size, names: True

    def families(self, stems: dict[str, str]) -> dict[tuple[str, ...], dict[str, tuple[str, ...]]]:
        """By their texts, the names of each family and the numbers of each name."""
        families: defaultdict[tuple[str, ...], dict[str, tuple[str, ...]]] = defaultdict(dict)
        for name, stem in stems.items():
            numbers = self.pattern.findall(stem)
            digits = 0
            if self.halved and numbers and len(numbers[-1]) % 2 == 0:
                digits = len(numbers[-1])
                numbers[-1:] = numbers[-1][: digits // 2], numbers[-1][digits // 2 :]
            if 0 < len(numbers) <= _MAX_FIELDS:
                families[*self.pattern.split(stem.lower()), "0" * digits][name] = tuple(numbers)
        return families


def _is_whole(numbered: NumberedNames, size: int, names: int) -> bool:
    """Whether halved numbers fill a grid, and do not just run on: 00 to 29 is no grid of 3x10."""
    if numbered.runs or numbered.share < 1:
        return False
    numbers = [
        int(re.findall(r"[0-9]+", name.rpartition(".")[0])[-1]) for name in numbered.views.values()
    ]
    return max(numbers) - min(numbers) >= len(numbers)


_READINGS = (  # the likeliest first
    _Reading(
        name="signs after a separator",
        pattern=re.compile(rf"(?:{_SIGNED}|[0-9]{{1,18}}){_DECIMAL}"),
    ),
    _Reading(name="signs anywhere", pattern=re.compile(rf"[+-]?[0-9]{{1,18}}{_DECIMAL}")),
    _Reading(name="digits alone", pattern=re.compile(r"[0-9]{1,18}")),
    _Reading(
        name="single letters",
        pattern=re.compile(r"[0-9]{1,18}|(?<![A-Za-z])[A-Za-z](?![A-Za-z])"),
        # of fewer names, they are Roman numerals or initials
        accepts=lambda numbered, size, names: 2 * size >= names,
    ),
    _Reading(
        name="halves of a number",
        pattern=re.compile(r"[0-9]{1,18}"),
        halved=True,
        accepts=_is_whole,
    ),
)


def _together(columns: Collection[_Column]) -> list[tuple[int, ...]]:
    """By name, its numbers in these columns."""
    return list(zip(*(column.numbers for column in columns), strict=True))


def _way(numbered: NumberedNames, order: float = 0.0, frames: int = 1) -> Candidate[NumberedNames]:
    """A way to count with its score: how many names it explains (a run's count less, so that a grid
    of nearly all of them beats it), then how full its grid is, then `order` among equals.
    """
    shape = f"a run of {numbered.cols}" if numbered.runs else f"{numbered.rows}x{numbered.cols}"
    return Candidate(
        what=shape + f" with {frames} frames" * (frames > 1),
        score=numbered.explained * (_RUN if numbered.runs else 1) + _WHOLE * numbered.share + order,
        value=numbered,
        evidence={
            "names explained": numbered.explained,
            "places with a name": numbered.share,
            "clashes": len(numbered.clashes),
        },
    )


def _ways(names: list[str], columns: list[_Column]) -> list[Candidate[NumberedNames]]:
    """What the numbers of a family may count, the likeliest first; with a doubt where the second
    is as likely.
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
    if not ways:  # the numbers together run
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
                best.value, doubt=f"what the numbers in the names count: {best.what}, or {near[0]}"
            ),
        )
    return [best, *others]


def _grids(names: list[str], columns: list[_Column]) -> Iterator[Candidate[NumberedNames]]:
    """The names by every two numbers that may count rows and columns."""
    for (first, down), (second, across) in combinations(enumerate(columns), 2):
        plain = all(column.steps[:2] in ((0, _UNIT), (_UNIT, _UNIT)) for column in (down, across))
        pairs = len(set(_together((down, across))))
        if pairs == len(names) == len(down.values) * len(across.values):
            # then order counts where steps are uneven
            down, across = (
                column.ordered() if column.count > 2 * len(column.values) else column
                for column in (down, across)
            )
        if max(down.count, across.count) > MAX_SIDE or pairs < _MIN_COVERAGE * (
            down.count * across.count
        ):
            continue
        if down.word in _COL_WORDS and across.word in _ROW_WORDS:
            down, across = across, down
        yield _way(
            placed(names, down.places, across.places, (down.count, across.count)),
            _PLAIN * plain - _LATER * (first + second),
        )


def _without_frames(
    names: list[str], frames: _Column, columns: list[_Column]
) -> Iterator[Candidate[NumberedNames]]:
    """What the other numbers count, in the names of the first frame."""
    first = [at for at, number in enumerate(frames.numbers) if number == frames.values[0]]
    kept = [
        attrs.evolve(column, numbers=tuple(column.numbers[at] for at in first))
        for column in columns
        if column != frames
    ]
    for way in _ways([names[at] for at in first], kept):
        numbered = attrs.evolve(way.value, explained=len(names))
        order = _PLAIN if frames.word in _FRAME_WORDS else _LATER * columns.index(frames)
        yield _way(numbered, order, len(frames.values))


def placed(
    names: list[str], rows: list[int] | None, cols: list[int], shape: ViewIndex, counts: bool = True
) -> NumberedNames:
    """Names by their places; of several for one, the first. rows: None for a number that runs;
    counts: whether numbers and not only their order say so.
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
    """The numbers that may count frames or exposures, where those of views and they fill a box: the
    one after a word that says so, else each of three.
    """
    for columns in [*combinations(varying, 3), *combinations(varying, 2)]:
        whole = math.prod(len(column.values) for column in columns)
        if whole == count == len(set(_together(columns))):
            named = [column for column in columns if column.word in _FRAME_WORDS]
            if named or len(columns) == 3:
                return named[:1] or list(columns)
    return []


def _by_folder(names: tuple[str, ...]) -> NumberedNames | None:
    """Rows by folder, columns by the order of names in each, where all folders hold equally many,
    two or more; else None.
    """
    folders: defaultdict[str, list[str]] = defaultdict(list)
    for name in names:
        folders[name.rpartition("/")[0]].append(name)
    counts = {len(inside) for inside in folders.values()}
    if len(folders) < 2 or len(counts) > 1 or counts == {1}:
        return None
    views = {
        (row, col): name
        for row, inside in enumerate(folders.values())
        for col, name in enumerate(inside)
    }
    return NumberedNames(views=views, rows=len(folders), cols=counts.pop(), runs=False)


def _candidates(names: tuple[str, ...]) -> Iterator[Candidate[NumberedNames]]:
    """What each family says by each reading; no more once nothing can be better."""
    stems = _stems(names)
    for number, reading in enumerate(_READINGS):
        families = reading.families(stems)
        most = max((len(family) for family in families.values()), default=0)
        for texts, family in families.items():
            if len(family) < 2 or 2 * len(family) < most:
                continue
            fields = zip(zip(*family.values(), strict=True), texts, strict=False)
            columns = [_Column.of(numbers, before) for numbers, before in fields]
            maps = any(MAPS.search(text) for text in texts)
            ways = [
                attrs.evolve(
                    way,
                    what=f"{'#'.join(texts[:-1])}: {reading.name}, {way.what}",
                    score=way.score / (1 + maps) - _NEXT_READING * number,
                )
                for way in _ways(list(family), columns)
                if reading.accepts(way.value, len(family), len(names))
            ]
            yield from ways
            if ways and ways[0].score > len(names) + _WHOLE - _NEXT_READING * (number + 1):
                return


@lru_cache(maxsize=4)
def read_names(names: tuple[str, ...]) -> NumberedNames | None:
    """What the numbers of most of these names say; None where no two names differ in numbers
    alone.
    """
    order = ranked(f"how {len(names)} names count", list(_candidates(names)))
    best = order[0].value if order else None
    if best is None or best.runs or best.clashes:
        return _by_folder(names) or best
    return best
