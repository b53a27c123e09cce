"""The part of a file name that its numbers are read from: without sums and suffix, times of day in seconds, copies counted."""

import re
from collections import defaultdict

_TIMES = (  # of day, as phones and messengers write them: behind a date, or with separators
    re.compile(r"(?<=\d{8}[-_])([01]\d|2[0-3])([0-5]\d)([0-5]\d)(?=\d{3}(?!\d)|\D|$)"),
    re.compile(r"(?<=[ _T])([01]\d|2[0-3])(?P<between>[.:_-])([0-5]\d)(?P=between)([0-5]\d)(?!\d)"),
)
_SUM = re.compile(r"[-_. ](?=[0-9a-f]*[a-f])(?=[0-9a-f]*[0-9])[0-9a-f]{6,40}$", re.IGNORECASE)
_SUM_OR_NUMBER = re.compile(r"[-_. ][0-9a-f]{6,40}$", re.IGNORECASE)
_COPY = re.compile(r"(.*?)([-_ ]?\(|[-_ ])(\d{1,5})(\)?)")
_SAME_KIND = {"jpeg": "jpg", "jpe": "jpg", "tiff": "tif"}


def _seconds(time: re.Match[str]) -> str:
    hours, minutes, seconds = (int(group) for group in time.groups() if group.isdigit())
    return f"{3600 * hours + 60 * minutes + seconds:05d}"


def stems_of(names: tuple[str, ...]) -> dict[str, tuple[str, str]]:
    """The part of each name that is read, and its kind (jpg for .jpeg, too).

    Times of day are in seconds, sums at the end are left out, and the first of copies gets the number that it lacks: photo.jpg,
    photo (1).jpg, ... and shot.png, shot 2.png, ...
    """
    stems = {name: name.rpartition(".")[0] for name in names}
    for time in _TIMES:
        if 2 * sum(time.search(stem) is not None for stem in stems.values()) > len(names):
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
