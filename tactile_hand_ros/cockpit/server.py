# SPDX-License-Identifier: Apache-2.0
"""The web server of the cockpit: one page, one WebSocket per tab, in a thread of its own.

Only requests with the token of the link are served. Their Host and Origin must be those of the
link, so that no other site of the browser, and no name that another site lets point here, can
use it. A tab asks for a picture when it has drawn the last one. A slow or suspended tab therefore
gets fewer pictures, never old ones, and costs nothing. Commands are answered, each with its number.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import secrets
import struct
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from tactile_hand_ros.cockpit.picture import Picture
from tactile_hand_ros.errors import TactileHandError
from tactile_hand_ros.extras import optional

web = optional("aiohttp.web", "the cockpit")

Reply = Callable[[bool, str], None]

_HEAD = struct.Struct("<III")
_LARGEST = 65_536  # bytes of a command
_START = 10.0  # s


class ServerError(TactileHandError):
    """The page cannot be offered."""


class Host(Protocol):
    """What the server shows and steers; it is called from the thread of the server."""

    picture: Picture | None
    report: Path | None
    status: dict[str, Any]  # replaced as a whole a few times a second

    def hello(self) -> dict[str, Any]:
        """Return what a tab must know before the first picture."""

    def submit(self, command: Mapping[str, Any], reply: Reply) -> None:
        """Carry out a command; `reply` may be called from any thread."""

    def released(self) -> None:
        """Note that no tab has control any more."""


class Tab:
    """One tab of a browser.

    Attributes:
        number: Its number, from 1 on.
        epoch: The epoch of the picture that it has, -1 before the first.
        total: Rows that it has.
    """

    def __init__(self, number: int, socket: Any) -> None:
        """Start without a picture."""
        self.number, self._socket = number, socket
        self.epoch, self.total = -1, 0
        self.is_ready, self.news = asyncio.Event(), asyncio.Event()
        self._sent: tuple[Any, int] = ({}, -1)

    async def serve(self, host: Host, driver: Callable[[], int]) -> None:
        """Send a picture whenever there is news and the tab is ready for it, until it is gone."""
        with contextlib.suppress(ConnectionError):
            while True:
                await self._serve(host, driver)

    async def _serve(self, host: Host, driver: Callable[[], int]) -> None:
        await self.is_ready.wait()
        await self.news.wait()
        self.news.clear()
        picture = host.picture
        if picture is not None and picture.epoch != self.epoch:
            self.epoch, self.total = picture.epoch, 0
            await self.send({"hello": host.hello()})
        status = host.status, driver()
        if status != self._sent:
            self._sent = status
            await self.send({"status": host.status | {"driver": driver()}})
        if picture is not None and picture.total != self.total:
            self.total, times, rows = picture.since(self.total)
            head = _HEAD.pack(self.epoch, *rows.shape)
            self.is_ready.clear()
            await self._socket.send_bytes(head + bytes(4) + times.tobytes() + rows.tobytes())

    async def send(self, message: Mapping[str, Any]) -> None:
        """Send a message."""
        await self._socket.send_str(json.dumps(message))


class Server:
    """Serves a host until `close`.

    Attributes:
        link: The address with the token; anyone who has it may watch and steer.
    """

    def __init__(self, host: Host, page: str, address: str, port: int) -> None:
        """Start the thread; port 0 takes a free one.

        Raises:
            ServerError: If the address cannot be used.
        """
        self._host, self._page, self._address = host, page, address
        self._token = secrets.token_urlsafe(24)
        self._tabs: dict[int, Tab] = {}
        self._count = self._driver = 0
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="cockpit", daemon=True)
        self._thread.start()
        starting = asyncio.run_coroutine_threadsafe(self._start(port), self._loop)
        try:
            self.port: int = starting.result(_START)
        except OSError as error:
            reason = os.strerror(error.errno or 0).lower()
            raise ServerError(
                f"the page cannot be served at {address}:{port} ({reason}); choose another port, "
                "or 0 for any free one"
            ) from None
        self.link = f"http://{address}:{self.port}/?token={self._token}"

    async def _start(self, port: int) -> int:
        app = web.Application()
        app.add_routes([
            web.get("/", self._on_page),
            web.get("/socket", self._on_socket),
            web.get("/report", self._on_report),
        ])  # fmt: skip
        self._runner = web.AppRunner(app, access_log=None, shutdown_timeout=0.5)
        await self._runner.setup()
        site = web.TCPSite(self._runner, self._address, port)
        await site.start()
        return int(self._runner.addresses[0][1])

    def notify(self) -> None:
        """Wake up the tabs; call it from any thread when there is a new picture or status."""
        self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        for tab in self._tabs.values():
            tab.news.set()

    def close(self) -> None:
        """Close all connections and stop the thread."""
        stopping = asyncio.run_coroutine_threadsafe(self._runner.cleanup(), self._loop)
        stopping.result(_START)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _check(self, request: Any) -> None:
        """Refuse a request with a wrong host, origin or token."""
        hosts = {f"{name}:{self.port}" for name in (self._address, "localhost")}
        origin = request.headers.get("Origin", f"http://{request.host}")
        if request.host not in hosts or origin != f"http://{request.host}":
            raise web.HTTPForbidden(text=_FOREIGN.format(origin, self._address, self.port))
        given = request.query.get("token", "")
        if not secrets.compare_digest(given.encode(), self._token.encode()):
            raise web.HTTPForbidden(text=_NO_TOKEN)

    async def _on_page(self, request: Any) -> Any:
        self._check(request)
        return _html(self._page)

    async def _on_report(self, request: Any) -> Any:
        self._check(request)
        file = self._host.report
        if file is None or not file.is_file():
            raise web.HTTPNotFound(text="There is no report yet; press Save first.")
        return _html(file.read_text("utf-8"))

    async def _on_socket(self, request: Any) -> Any:
        self._check(request)
        if "Origin" not in request.headers:
            raise web.HTTPForbidden(text=_FOREIGN.format("", self._address, self.port))
        socket = web.WebSocketResponse(max_msg_size=_LARGEST, heartbeat=20.0)
        await socket.prepare(request)
        self._count += 1
        tab = Tab(self._count, socket)
        self._tabs[tab.number] = tab
        self._driver = self._driver or tab.number
        tab.news.set()
        await tab.send({"welcome": tab.number})
        serving = asyncio.ensure_future(tab.serve(self._host, lambda: self._driver))
        try:
            async for message in socket:
                await self._on_message(tab, message.data)
        finally:
            serving.cancel()
            del self._tabs[tab.number]
            if self._driver == tab.number:
                self._drive(0)
        return socket

    async def _on_message(self, tab: Tab, text: Any) -> None:
        try:
            command = json.loads(text)
            number, what = command.get("id"), command["do"]
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            await tab.send({"reply": None, "ok": False, "text": _NO_COMMAND})
            return
        if what == "ready":
            tab.is_ready.set()
        elif what == "drive":
            self._drive(tab.number)
            await tab.send({"reply": number, "ok": True, "text": "this tab has control"})
        elif tab.number != self._driver:
            await tab.send({"reply": number, "ok": False, "text": _WATCHING})
        else:
            self._host.submit(command, self._replying(tab, number))

    def _drive(self, number: int) -> None:
        self._driver = number
        self._host.released()
        self._wake()

    def _replying(self, tab: Tab, number: Any) -> Reply:
        def reply(ok: bool, text: str) -> None:
            answer = {"reply": number, "ok": ok, "text": text}
            asyncio.run_coroutine_threadsafe(self._answer(tab, answer), self._loop)

        return reply

    async def _answer(self, tab: Tab, answer: Mapping[str, Any]) -> None:
        if tab.number in self._tabs:
            await tab.send(answer)


def _html(text: str) -> Any:
    headers = {
        "Cache-Control": "no-store",
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
    }
    return web.Response(text=text, content_type="text/html", headers=headers)


_NO_TOKEN = (
    "This link has no valid token, or an old one; open the link that the cockpit has printed."
)
_FOREIGN = "The request comes from '{}', but the cockpit only serves its own page, http://{}:{}."
_NO_COMMAND = 'the message is not a command, expected JSON such as {"id": 1, "do": "pause"}'
_WATCHING = "another tab has control; press Take over first"
