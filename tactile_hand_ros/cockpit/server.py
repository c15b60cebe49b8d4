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
import functools
import json
import secrets
import socket
import struct
import threading
from collections.abc import Callable, Mapping
from typing import Any

from tactile_hand_ros.errors import ConfigurationError
from tactile_hand_ros.extras import optional

Reply = Callable[[bool, str], None]

_HEAD = struct.Struct("<IIII")  # epoch, rows, width, nothing
_PERIOD = 1.0 / 60.0  # s between two looks for news
_ADDRESS = "127.0.0.1"
_LARGEST = 65_536  # bytes of a command


class Tab:
    """One tab of a browser, with the epoch and the number of rows of the picture that it has."""

    def __init__(self, socket: Any) -> None:
        """Start without a picture."""
        self._socket = socket
        self.epoch, self.total, self.status = -1, 0, dict[str, Any]()
        self.is_ready = asyncio.Event()
        self.is_ready.set()

    async def send(self, **message: Any) -> None:
        """Send a message."""
        await self._socket.send_str(json.dumps(message))

    async def show(self, node: Any, drives: bool) -> None:
        """Send what is new."""
        picture, status = node.picture, {**node.status, "drives": drives}
        if picture.epoch != self.epoch:
            self.epoch, self.total = picture.epoch, 0
            await self.send(hello=node.hello())
        if status != self.status:
            self.status = status
            await self.send(status=status)
        if picture.total != self.total:
            self.total, times, rows = picture.since(self.total)
            head = _HEAD.pack(self.epoch, *rows.shape, 0)
            self.is_ready.clear()
            await self._socket.send_bytes(head + times.tobytes() + rows.tobytes())


class Server:
    """Serves the page of a `CockpitNode` as long as the process lives.

    Attributes:
        link: The address with the token; anyone who has it may watch and steer.
    """

    def __init__(self, node: Any, page: str, port: int) -> None:
        """Start the thread, on this machine only; port 0 takes a free one.

        Raises:
            ConfigurationError: If the port cannot be used.
            MissingLibraryError: If aiohttp is not installed.
        """
        self._web = web = optional("aiohttp.web", "The cockpit")
        try:
            listener = socket.create_server((_ADDRESS, port))
        except OSError as error:
            raise ConfigurationError(
                f"the page cannot be served: {error.strerror}; choose another port, or 0 for any "
                "free one"
            ) from None
        self._node, self._page = node, page
        self._token = secrets.token_urlsafe(24)
        self._driver: Tab | None = None
        port = listener.getsockname()[1]
        self._hosts = [f"{_ADDRESS}:{port}", f"localhost:{port}"]
        self.link = f"http://{_ADDRESS}:{port}/?token={self._token}"
        app = web.Application()
        app.add_routes([
            web.get("/", self._on_page),
            web.get("/socket", self._on_socket),
            web.get("/report", self._on_report),
        ])  # fmt: skip
        self._loop = asyncio.new_event_loop()
        run = functools.partial(web.run_app, app, sock=listener, loop=self._loop)
        options = {"print": None, "access_log": None, "handle_signals": False}
        threading.Thread(target=run, kwargs=options, name="cockpit", daemon=True).start()

    def _check(self, request: Any) -> None:
        """Refuse a request with a wrong host, origin or token."""
        origin = request.headers.get("Origin", f"http://{request.host}")
        if request.host not in self._hosts or origin != f"http://{request.host}":
            raise self._web.HTTPForbidden(
                text=f"The request comes from '{origin}', but the cockpit only serves its own "
                f"page, http://{self._hosts[0]}."
            )
        given = request.query.get("token", "")
        if not secrets.compare_digest(given.encode(), self._token.encode()):
            raise self._web.HTTPForbidden(
                text="This link has no valid token, or an old one; open the link that the cockpit "
                "has printed."
            )

    async def _on_page(self, request: Any) -> Any:
        self._check(request)
        return self._html(self._page)

    async def _on_report(self, request: Any) -> Any:
        self._check(request)
        if self._node.report is None:
            raise self._web.HTTPNotFound(text="There is no report yet; press Save first.")
        return self._html(self._node.report.read_text("utf-8"))

    async def _on_socket(self, request: Any) -> Any:
        self._check(request)
        connection = self._web.WebSocketResponse(
            max_msg_size=_LARGEST, heartbeat=20.0, compress=False
        )
        await connection.prepare(request)
        tab = Tab(connection)
        self._driver = self._driver or tab
        serving = asyncio.ensure_future(self._serve(tab))
        try:
            async for message in connection:
                self._on_command(tab, json.loads(message.data))
        finally:
            serving.cancel()
            if self._driver is tab:
                self._driver = None
        return connection

    async def _serve(self, tab: Tab) -> None:
        """Send what is new whenever the tab is ready for it, until it is gone."""
        with contextlib.suppress(ConnectionError):
            while True:
                await tab.is_ready.wait()
                await tab.show(self._node, tab is self._driver)
                await asyncio.sleep(_PERIOD)

    def _on_command(self, tab: Tab, command: Mapping[str, Any]) -> None:
        def reply(ok: bool, text: str) -> None:
            answer = tab.send(reply=command.get("id"), ok=ok, text=text)
            asyncio.run_coroutine_threadsafe(answer, self._loop)

        if command["do"] == "ready":
            tab.is_ready.set()
        elif command["do"] == "drive":
            self._driver = tab
            reply(True, "this tab has control")
        elif tab is not self._driver and command["do"] != "parameters":
            reply(False, "another tab has control; press Take over first")
        else:
            self._node.submit(command, reply)

    def _html(self, text: str) -> Any:
        headers = {"Cache-Control": "no-store", "Referrer-Policy": "no-referrer"}
        return self._web.Response(text=text, content_type="text/html", headers=headers)
