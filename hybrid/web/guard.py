"""What is let through to the page: its own few addresses, from its own origin, and no more.

Gradio has routes that take and give files by path, fetch addresses and run code. The page needs
none of them, so what is not on the list below does not exist.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

_ALLOWED = {
    "GET": re.compile(
        r"/(config|theme\.css|favicon\.ico|robots\.txt)?"
        r"|/(assets|static)/[\w@.-]+(/[\w@.-]+)*"
        r"|/gradio_api/(info|startup-events|theme\.css|queue/data|heartbeat/\w+)"
        r"|/pictures/[\w-]{22}/[\w.-]+"
    ),
    "POST": re.compile(r"/pictures|/gradio_api/(queue/join|reset|cancel)"),
}
_POLICY = "; ".join(
    [
        "default-src 'self'",
        "script-src 'self' 'unsafe-inline' 'unsafe-eval'",  # Gradio compiles templates
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data: blob:",
        "font-src 'self' data:",
        "object-src 'none'",
        "base-uri 'self'",
        "form-action 'self'",
        "frame-ancestors 'none'",
    ]
)
_HEADERS = {
    "Content-Security-Policy": _POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Guard:
    """Middleware that refuses foreign hosts, foreign origins and unknown addresses.

    Args:
        app: What is guarded.
        hosts: Names under which the page may be asked for, without a port; empty for any. A page
            elsewhere that points its own name at this machine is so kept out.
    """

    def __init__(self, app: ASGIApp, hosts: Collection[str]) -> None:
        self._app, self._hosts = app, frozenset(hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer or pass on one request."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return  # no websockets here
        refusal = self._refusal(scope)
        if refusal is not None:
            await PlainTextResponse(refusal[1], refusal[0], _HEADERS)(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        await self._app(scope, receive, with_headers)

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        """Status and reason if the request is not for this page."""
        headers = Headers(scope=scope)
        host = urlsplit(f"//{headers.get('host', '')}")
        if self._hosts and host.hostname not in self._hosts:
            return 403, "unknown host"
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host.netloc:
            return 403, "foreign origin"
        method = "GET" if scope["method"] == "HEAD" else scope["method"]
        allowed = _ALLOWED.get(method)
        if allowed is None or not allowed.fullmatch(scope["path"]) or ".." in scope["path"]:
            return 404, "not found"
        return None
