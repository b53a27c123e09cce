"""The conditions that results depend on: source, versions, machine, inputs."""

import hashlib
import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import lfpipe
from lfpipe.bench.inputs import Inputs
from lfpipe.bench.results import Subject
from lfpipe.host.machine import versions
from lfpipe.host.processes import usable_cores


def source_digest() -> str:
    """Hash of the package's own files: a changed program measures again."""
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(Path(lfpipe.__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _git(*words: str) -> str:
    command = ["git", *words]
    try:
        here = Path(lfpipe.__file__).parent
        done = subprocess.run(command, capture_output=True, text=True, cwd=here, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def describe(subject: Subject, inputs: Inputs) -> tuple[str, dict[str, str]]:
    """(identity, about) of a subject's results: all conditions that they depend on."""
    built = versions()
    processor = built.pop("processor")
    about = {"command": " ".join(["lfpipe", *sys.argv[1:]]), "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())}
    parts: list[Any] = [inputs.quick, source_digest(), sorted(built.items())]
    if "scene" in subject.needs:
        parts += [field.manifest.get("key", "") for _, field in inputs.fields]
        about["scene"] = "; ".join(
            f"{one.name}: {one.rows}x{one.cols} views of {one.width_px}x{one.height_px} px, disparity {one.disparity_source}"
            for _, one in inputs.fields
        )
    if "sequence" in subject.needs:
        one = inputs.sequence
        parts += [one.path.name, len(one.frames), one.truth is not None]
        truth = "truth known" if one.truth else "no truth"
        about["sequence"] = f"{one.path.name}: {len(one.frames)} frames at {one.rate_hz:g} Hz, {truth}"
    load = f"load {os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else ""
    about["machine"] = f"{processor}, {len(usable_cores())} cores, {platform.system()} {platform.release()}, {load}"
    about["versions"] = ", ".join(f"{name} {version}" for name, version in built.items())
    commit, changed = _git("rev-parse", "--short=12", "HEAD"), _git("status", "--porcelain", "--untracked-files=no")
    about["commit"] = commit + (" with changes" if changed else "") if commit else "not a git checkout"
    return hashlib.blake2b(json.dumps(parts).encode(), digest_size=12).hexdigest(), about
