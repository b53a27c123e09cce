"""Cores and niceness of stages: parses `governor.affinity` and `governor.nice`."""

from collections.abc import Iterable, Mapping

from lfpipe.errors import UserError
from lfpipe.host.processes import set_scheduling

LOWEST, HIGHEST = -20, 19  # limits of niceness in the kernel


def _pairs(key: str, text: str, names: Iterable[str], example: str) -> dict[str, str]:
    """`a=1,b=2` as a map. Raises UserError for anything else, and for an unknown name."""
    known, found = list(names), {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, sign, value = part.partition("=")
        if not sign or name.strip() not in known:
            raise UserError(f"{key}: {part!r} is not STAGE=VALUE with a stage of {', '.join(known)}", f"for example: {example}")
        found[name.strip()] = value.strip()
    return found


def cores(text: str, stages: Mapping[str, bool], allowed: Iterable[int]) -> dict[str, tuple[int, ...]]:
    """stage -> cores, from `governor.affinity`; the operating system places stages that are not listed.

    stages: name -> whether it avoids the first core. auto: on two cores, those stages get the second; with more, the operating
    system decides. Raises UserError for invalid text and for a core that is not allowed.
    """
    usable = sorted(allowed)
    if text == "auto":
        if len(usable) != 2:
            return {}
        return {name: (usable[own_core],) for name, own_core in stages.items()}
    if text == "none":
        return {}
    example = f"track={usable[-1]},render={usable[0]}, or {usable[0]}+{usable[-1]} for either; auto; none"
    found: dict[str, tuple[int, ...]] = {}
    for name, value in _pairs("governor.affinity", text, stages, example).items():
        parts = value.split("+")
        if not all(part.isdecimal() for part in parts):
            raise UserError(f"governor.affinity: {name}={value}: expected cores joined by +", f"for example: {example}")
        found[name] = tuple(sorted({int(part) for part in parts}))
        if missing := set(found[name]) - set(usable):
            remedy = f"use one of {', '.join(map(str, usable))}"
            raise UserError(f"governor.affinity: {name}={value}: core {min(missing)} does not exist on this machine", remedy)
    return found


def niceness(text: str, names: Iterable[str]) -> dict[str, int]:
    """stage -> niceness, from `governor.nice`. Raises UserError for invalid text."""
    example = "render=0,track=5"
    found: dict[str, int] = {}
    for name, value in _pairs("governor.nice", text, names, example).items():
        try:
            found[name] = int(value)
        except ValueError:
            raise UserError(f"governor.nice: {name}={value}: not a whole number", f"for example: {example}") from None
        if not LOWEST <= found[name] <= HIGHEST:
            raise UserError(f"governor.nice: {name}={value}: out of range: {LOWEST} to {HIGHEST}", f"for example: {example}")
    return found


def settle(cores: tuple[int, ...], nice: int | None) -> None:
    """Applies cores and niceness to the calling process. Raises UserError if that niceness is not permitted."""
    try:
        set_scheduling(cores, nice)
    except PermissionError:
        remedy = "use a higher number, or raise the limit (`ulimit -e`; `nice` in limits.conf)"
        raise UserError(f"governor.nice: {nice} needs a privilege that you do not have", remedy) from None
