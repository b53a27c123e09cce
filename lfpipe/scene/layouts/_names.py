"""Interprets the names of pictures: their words, by one table for all layouts, and their numbers,
row and column or a running number. docs/layouts.md states the rules.

A word ends where a separator, a digit or a change of case is: `leftImg8bit_0001` has the words
left, img, 8, bit, 0001. Letters within a word mean nothing: Segovia is no segmentation.

A name is also split into texts and numbers; names with the same texts form a family. Two numbers
are row and column if they vary, neither is a counter, and their pairs explain nearly all names.
"""

import math
import re
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from functools import lru_cache
from itertools import combinations

import attrs

from lfpipe.scene.source import ViewIndex, stem_of

_ENDS = re.compile(  # of words, between letters of two kinds
    r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|(?<=[^\W\d_])(?=\d)|(?<=\d)(?=[^\W\d_])"
)
_PART = re.compile(r"[^\W_]+")
_TIME = re.compile(r"\d+( \d+)?$")  # the key of a name that is a number


@lru_cache(maxsize=1 << 14)
def words(name: str) -> str:
    """The words of a name in lower case, each between two spaces; its ending is none of them."""
    return f" {' '.join(_PART.findall(_ENDS.sub(' ', stem_of(name)).lower()))} "


def _table(*texts: str) -> re.Pattern[str]:
    """Any of these words, or of words in a row; each as a regular expression."""
    return re.compile(f"(?<= )(?:{'|'.join(texts)})(?= )")


COLOUR = _table("rgb", "colou?r(ed)?s?", "images?", "imgs?", "photos?", "pictures?")
# larger is nearer by definition
INVERSE = _table("disp(arity|arities|s)?", "inv(erse)?", "idepths?")
_DEPTH_ = r"(depth|disparity|disp) ?maps?|i?depths?|disp(arity|arities|s)?|dpt|dmap"
DEPTH = _table(_DEPTH_)
MAPS = _table(  # of a value for each pixel; what a scene looks like in small
    _DEPTH_,
    *("masks?", "matte", "alpha", "labels?", "seg(mentation)?s?", "semantics?", "normals?"),
    *("flow", "conf(idence)?s?", "thumb(nail)?s?", "err(or)?s?", "diffs?", "gt", "class(es)?"),
    *("occ(lusion)?s?", "ir", "infra(red)?"),
)
RECORDED = _table("rgb", "colou?r(ed)?s?", "frames?")  # frames over time, if they have depth
VIEWS = _table("views?", "viewpoints?", "cam(era)?s?", "inputs?")  # of one moment
_PLAIN = _table("maps?", "raw", "aligned", "registered", "rectified", "rect", "data", "bit")
EYES, _EYE_LETTERS = _table("left", "right"), _table("l", "r")
# folders of two cameras that recorded side by side
_CAMERA = _table("(image|img|cam|camera|colou?red|grey|gray|frame)s? \\d{1,2}")
# pairs by Middlebury, the left one first
NUMBERED_PAIRS = {"im 2": "im 6", "im 0": "im 1", "view 1": "view 5"}
NO_SCENE = _table(  # folders beside a scene
    *("macosx", "raw", "thumb(nail)?s?", "originals?", "backup", "calib(ration)?"),
)
RGBD = _table("rgb ?[dz]")
ANAGLYPH = _table("anaglyphs?")
ESLF = _table("eslf")
_BESIDE_ = r"[hf]?sbs|side by side|sidebyside|lrf?|rlf?|(left right|right left)"
_ABOVE_ = (
    r"h?ou|h?tab|[hf]?tb|[hf]?bt|over (and )?under|overunder|top (and )?bottom|bottom (and )?top"
)
BESIDE = _table(_BESIDE_, "parallel", "3 dh", "cross ?eyed?", "x ?eyed?")
ABOVE = _table(_ABOVE_, "3 dv")
CROSSED = _table("cross ?eyed?", "x ?eyed?", "rlf?", "right left", "h?bt", "bottom (and )?top")
HALF = _table(
    *("hsbs", "hou", "htab", "htb", "hbt", "half (width|height)"),
    *(f"h(alf)? ({_BESIDE_}|{_ABOVE_})", f"({_BESIDE_}|{_ABOVE_}) h(alf)?"),
)


def is_map(name: str) -> bool:
    """Whether a name says that it is no picture of a scene but a map of one, or its preview."""
    return MAPS.search(words(name)) is not None


def without(text: str, *tables: re.Pattern[str]) -> str:
    """Words that are in none of the tables, without those that say nothing about what a picture
    shows; numbers without zeros before them.
    """
    for table in (*tables, _PLAIN):
        text = table.sub("", text)
    return " ".join(word.lstrip("0") if word.isdigit() else word for word in text.split())


def side_of(name: str) -> tuple[str, bool] | None:
    """(the rest of a name, whether it is the left view); None if no word denotes a side. Whole
    words come before letters; if both sides are in it, the last one counts.
    """
    text = words(name)
    sides = [*EYES.finditer(text)] or [*_EYE_LETTERS.finditer(text)][-1:]
    if not sides:
        return None
    side = sides[-1][0]
    for match in reversed(sides):
        if match[0] == side and (match is sides[-1] or len({one[0] for one in sides}) == 1):
            text = f"{text[: match.start()]}*{text[match.end() :]}"
    return without(text), side.startswith("l")


def camera_of(folder: str) -> list[tuple[str, int]]:
    """The word and the number of a folder of one of several cameras; [] of another one."""
    match = _CAMERA.search(words(folder))
    word, _, number = match[0].rpartition(" ") if match else ("", "", "")
    return [(word, int(number))] if match else []


def eye_pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    """Left and right pictures: Middlebury's numbers; names that are equal but for the words of both
    sides; equal names in the folders of two cameras.
    """
    by_words = {words(name).strip(): name for name in names}
    for left, right in NUMBERED_PAIRS.items():
        alike = re.compile(left.rstrip("0123456789") + r"\d{1,4}")
        # more than two are all views of a Middlebury set
        if (
            left in by_words
            and right in by_words
            and sum(map(bool, map(alike.fullmatch, by_words))) <= 4
        ):
            return [(by_words[left], by_words[right])]
    folders = sorted({name.rpartition("/")[0] for name in names})
    cameras = len(folders) == 2 and all(map(camera_of, folders))
    sides: dict[str, dict[bool, str]] = {}
    for name in names:
        folder, _, rest = name.rpartition("/")
        if side := side_of(name) or ((words(rest), folder == folders[0]) if cameras else None):
            sides.setdefault(side[0], {}).setdefault(side[1], name)
    return [(both[True], both[False]) for both in sides.values() if len(both) == 2]


def pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    """Pictures with their maps of depth or disparity: names that are equal but for the words of
    both kinds, wherever they stand. In two folders of names that differ, as times do, each picture
    has the nearest map.
    """
    maps: dict[str, str] = {}
    firsts: dict[str, str] = {}
    for name in names:
        key = without(words(name), COLOUR, RECORDED, DEPTH, INVERSE)
        (maps if DEPTH.search(words(name)) else firsts).setdefault(key, name)
    equal = [(name, maps[key]) for key, name in firsts.items() if key in maps]
    if equal or not all("/" in name for name in names):
        return equal
    times = {float(key.replace(" ", ".")): name for key, name in maps.items() if _TIME.match(key)}
    return [
        (name, times[min(times, key=lambda time: abs(time - float(key.replace(" ", "."))))])
        for key, name in firsts.items()
        if times and _TIME.match(key)
    ]


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
            maps = bool(MAPS.search(words(next(iter(family)))))
            columns = [_column(texts) for texts in zip(*family.values(), strict=True)]
            for reading, share in _readings(list(family), columns):
                weight = (_RUN if reading.runs else 1) / (1 + maps)
                yield (len(reading.views) * weight, share), reading


@lru_cache(maxsize=4)
def read_names(names: tuple[str, ...]) -> NumberedNames | None:
    """The meaning of the numbers in most of these names; None if no two names differ in numbers
    alone.
    """
    readings = _families({name: stem_of(name) for name in names})
    return max(readings, key=lambda one: one[0], default=(None, None))[1]
