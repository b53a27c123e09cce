"""The configuration as TOML for people: every key with its default, unit, range and meaning."""

import json
import math
from typing import Any, get_args

from lfpipe.config.keys import options
from lfpipe.config.tree import Config, Opt, to_dict


def _range(kind: Any, opt: Opt) -> str:
    words = [word for part in get_args(kind) if not isinstance(part, type) for word in (get_args(part) or (part,))]
    limits = f"{opt.low:g} to {opt.high:g}" if math.isfinite(opt.low) else ""
    said = " or ".join(part for part in (f"{limits} {opt.unit}".strip(), ", ".join(map(str, words))) if part)
    return f" [{said}]" if said else ""


def _toml(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)  # TOML allows no surrogate pairs


def commented(config: Config | None = None) -> str:
    """TOML text of config (the defaults when None), a comment above each key."""
    tree = to_dict(config or Config())
    lines = ["# Every key of lfpipe. `--set SECTION.KEY=VALUE` changes one for one run.", ""]
    section = ""
    for key, (kind, opt, default) in options().items():
        head, _, name = key.partition(".")
        if head != section:
            lines += ([""] if section else []) + [f"[{head}]"]
            section = head
        live = "; `lfpipe ctl set` changes it live" if opt.live else ""
        was = "" if tree[head][name] == default else f"; default {_toml(default)}"
        lines += [f"# {opt.doc}{_range(kind, opt)}{live}{was}", f"{name} = {_toml(tree[head][name])}"]
    return "\n".join(lines) + "\n"
