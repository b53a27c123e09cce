"""Forwards the eyes that a session shares by OSC to web pages, which cannot receive UDP.

Usage: python eyes_to_page.py OSC_PORT WEB_PORT
"""

import asyncio
import json
import sys

import tornado.web
import tornado.websocket

try:
    from pythonosc.dispatcher import Dispatcher
    from pythonosc.osc_server import AsyncIOOSCUDPServer
except ImportError:
    sys.exit("python-osc is missing: pip install 'lfpipe[share]'")

if len(sys.argv) != 3:
    sys.exit(__doc__)
osc_port, web_port = (int(word) for word in sys.argv[1:])
pages: set["Eyes"] = set()


class Eyes(tornado.websocket.WebSocketHandler):
    """ws://127.0.0.1:WEB_PORT/eyes: {"left": [x, y, z], "right": [x, y, z]} in mm a frame."""

    def open(self, *_words: str, **_named: str) -> None:
        pages.add(self)

    def on_close(self) -> None:
        pages.discard(self)

    def check_origin(self, origin: str) -> bool:
        """Whether a page may have them."""
        return origin in ("null", f"http://127.0.0.1:{web_port}", "http://127.0.0.1:8000")


def pass_on(_address: str, *values: float) -> None:
    for page in pages:
        page.write_message(json.dumps({"left": values[:3], "right": values[3:]}))


async def main() -> None:
    dispatcher = Dispatcher()
    dispatcher.map("/lfpipe/eyes", pass_on)
    address = ("127.0.0.1", osc_port)
    loop = asyncio.get_running_loop()
    server = AsyncIOOSCUDPServer(address, dispatcher, loop)  # type: ignore[arg-type]
    await server.create_serve_endpoint()
    tornado.web.Application([("/eyes", Eyes)]).listen(web_port, "127.0.0.1")
    print("passing on", flush=True)
    await asyncio.Event().wait()


asyncio.run(main())
