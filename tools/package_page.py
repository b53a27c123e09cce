"""The package page, made of README.md when a package is built: there, paths within the repository
lead nowhere.

LFPIPE_URL in the environment is where the repository's files are served, such as the address of a
release's raw files: links and pictures then lead there. Without it links become plain text, and
pictures and the tables of them are left out.
"""

import os
import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(!?)\[([^\]]*)\]\((?![a-z]+:|#)([^)]+)\)")


def package_page(readme: str, url: str) -> str:
    """README.md for a page that does not have the repository's files beside it.

    url: "" where they are not served.
    """
    if url:
        return LINK.sub(lambda link: f"{link[1]}[{link[2]}]({url.rstrip('/')}/{link[3]})", readme)
    lines = []
    for paragraph in readme.split("\n\n"):
        if not re.search(r"!\[[^\]]*\]\(", paragraph):
            lines.append(
                LINK.sub(lambda link: link[2] if link[2] != link[3] else f"`{link[2]}`", paragraph)
            )
    return "\n\n".join(lines)


class CustomMetadataHook(MetadataHookInterface):
    """What hatchling runs for `dynamic = ["readme"]`."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Sets the readme."""
        url = os.environ.get("LFPIPE_URL", "")
        text = package_page((Path(self.root) / "README.md").read_text(encoding="utf-8"), url)
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
