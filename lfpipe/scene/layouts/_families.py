"""Families of file names: names with the same texts, and numbers between them.

A name is split into texts and numbers in several ways of reading, the likeliest first.
"""

from __future__ import annotations

import re
from collections import defaultdict
from fractions import Fraction

import attrs
import numpy as np
from numpy.typing import NDArray

_SIGNED = r"(?<=[^0-9A-Za-z])[+-][0-9]{1,18}"
_DECIMAL = r"(?:\.[0-9]{1,9})?(?![0-9]*\.[0-9])"
# Ways to read numbers, the likeliest first: signs after a separator and decimals; signs anywhere; digits alone; letters count.
READINGS = tuple(
    re.compile(pattern)
    for pattern in (
        rf"(?:{_SIGNED}|[0-9]{{1,18}}){_DECIMAL}",
        rf"[+-]?[0-9]{{1,18}}{_DECIMAL}",
        r"[0-9]{1,18}",
        r"[0-9]{1,18}|(?<![A-Za-z])[A-Za-z](?![A-Za-z])",
        r"[0-9]{1,18}",
    )
)
LETTERS = len(READINGS) - 2  # the reading in which a letter alone is a number
HALVES = len(READINGS) - 1  # the reading in which a number is row and column without a separator: 0307
MAPS = re.compile(
    r"depth|disp|mask|matte|alpha|label|seg|normal|flow(?!er)|conf(?!e)|thumb|error|diff|(?<![a-z])gt", re.IGNORECASE
)
# Names of the two eyes' pictures, by language.
LEFT, RIGHT = ("left", "l", "links", "gauche", "izquierda", "sinistra"), ("right", "r", "rechts", "droite", "derecha", "destra")
_MAX_FIELDS = 12
_MOST_FAMILIES = 500  # that are compared with each other


def _halves(number: str) -> list[str]:
    middle = len(number) // 2
    return [number] if len(number) % 2 else [number[:middle], number[middle:]]


def _value(text: str) -> Fraction:
    return Fraction(ord(text.lower()) - ord("a")) if text.isalpha() else Fraction(text)


@attrs.frozen(eq=False)
class Family:
    """Names with the same texts. numbers: by field, the values that occur, ascending, and which of them each name has; digits:
    how many the shortest one is written with."""

    texts: tuple[str, ...]
    names: list[str]
    numbers: list[tuple[list[Fraction], NDArray[np.int64]]]
    digits: list[int]

    @classmethod
    def of(cls, texts: tuple[str, ...], names: dict[str, tuple[str, ...]]) -> Family:
        numbers = []
        for column in zip(*names.values(), strict=True):
            separator = all(text.startswith("-") for text in column)  # and no sign, where every number has it
            by_text = {text: _value(text[separator:]) for text in set(column)}
            values = sorted(set(by_text.values()))
            rank = {value: position for position, value in enumerate(values)}
            code = {text: rank[value] for text, value in by_text.items()}
            numbers.append((values, np.array([code[text] for text in column], np.int64)))
        return cls(texts, list(names), numbers, [min(map(len, column)) for column in zip(*names.values(), strict=True)])

    def distinct(self, *fields: int) -> int:
        """How many combinations of the values of these fields occur."""
        codes = np.zeros(len(self.names), np.int64)
        for field in fields:
            codes = codes * len(self.numbers[field][0]) + self.numbers[field][1]
        return len(np.unique(codes))


def families_of(stems: dict[str, tuple[str, str]], rank: int) -> list[tuple[tuple[str, ...], dict[str, tuple[str, ...]]]]:
    """The texts of names, and the numbers of each name that has them. stems: as `stems_of` gives them."""
    reading = READINGS[rank]
    families: defaultdict[tuple[str, ...], dict[str, tuple[str, ...]]] = defaultdict(dict)
    for name, (stem, suffix) in stems.items():
        numbers, digits = reading.findall(stem), 0
        if rank == HALVES and numbers:
            digits = len(numbers[-1])
            numbers = [*numbers[:-1], *_halves(numbers[-1])]
        if 0 < len(numbers) <= _MAX_FIELDS:
            texts = (*reading.split(stem.lower()), suffix, "0" * digits)
            families[texts][name] = tuple(numbers)
    return _joined(families)


def _joined(
    families: dict[tuple[str, ...], dict[str, tuple[str, ...]]],
) -> list[tuple[tuple[str, ...], dict[str, tuple[str, ...]]]]:
    """The families; a few names of one that differ from those of a large one in a word too many, as of a burst's cover or an
    edited picture, fill the gaps of that: IMG_E1234 among IMG_1233, IMG_1235, ..."""
    if len(families) > _MOST_FAMILIES:  # unrelated names
        return list(families.items())
    for texts in sorted(families, key=lambda texts: len(families[texts])):
        family = families[texts]
        for others, large in families.items():
            fits = 8 * len(family) <= len(large) and _with_a_word(texts, others)
            if fits and set(large.values()).isdisjoint(family.values()):
                families[others] = {**large, **family}
                del families[texts]
                break
    return list(families.items())


def _with_a_word(texts: tuple[str, ...], others: tuple[str, ...]) -> bool:
    """Whether texts are the others but for letters put into one of them."""
    pairs = [(text, other) for text, other in zip(texts, others, strict=False) if text != other]
    if len(texts) != len(others) or len(pairs) != 1 or pairs[0][0] == texts[-2]:
        return False
    long, short = pairs[0]
    start = next((k for k, (a, b) in enumerate(zip(long, short, strict=False)) if a != b), min(len(long), len(short)))
    word = long[start : start + len(long) - len(short)]
    return word.strip("_- ").isalpha() and long[:start] + long[start + len(word) :] == short and not MAPS.search(word)
