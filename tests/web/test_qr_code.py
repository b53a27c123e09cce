"""The QR code of the page, read from the terminal as a phone reads it."""

import re

import cv2
import numpy as np

from tests.web.server import served, until
from tests.world import World

HALVES = {" ": (0, 0), "▀": (255, 0), "▄": (0, 255), "█": (255, 255)}  # of a dark terminal


def read_code(text: str) -> str:
    """What the lines of half blocks in text say."""
    lines = [line for line in text.splitlines() if re.fullmatch("[ ▀▄█]{20,}", line)]
    width = max(map(len, lines))
    picture = np.zeros((2 * len(lines), width), np.uint8)
    for row, line in enumerate(lines):
        for col, char in enumerate(line):
            picture[2 * row : 2 * row + 2, col] = HALVES[char]
    return cv2.QRCodeDetector().detectAndDecode(cv2.resize(picture, None, fx=8, fy=8, interpolation=cv2.INTER_NEAREST))[0]


def test_a_page_on_the_network_shows_its_address_as_a_code_and_one_for_this_machine_does_not(live: World) -> None:
    with served(live, "0.0.0.0:0") as server:
        until(lambda: "█" in server.log.read_text(), "code")
        said = read_code(server.log.read_text())
        assert re.fullmatch(rf"http://[^/]+:{server.port}/\?token={re.escape(server.token)}", said), said
    with served(live) as server:
        assert "█" not in server.log.read_text()
