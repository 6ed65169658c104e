"""The addresses of pictures and files: bytes in, bytes out, nothing by path.

POST /pictures takes a file as the request's body. GET /pictures/NAME/WHAT gives what the name of
128 random bits stands for, and ?fov= or ?balance= choose the view.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from functools import wraps

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from hybrid.web.downloads import make_file, offered
from hybrid.web.exhibit import View, degrees_across
from hybrid.web.studio import Studio

_PRIVATE = {"Cache-Control": "private, no-store"}
_Handler = Callable[[Request], Awaitable[Response]]


class _TooLargeError(Exception):
    """An upload over the limit."""


def picture_routes(studio: Studio) -> list[BaseRoute]:
    """The routes, to be put before those of the page."""

    async def upload(request: Request) -> Response:
        data = await _body(request, studio.limits.max_bytes)
        name = await run_in_threadpool(studio.take, data)
        exhibit = studio.exhibit(name)
        return JSONResponse({"name": name, "width": exhibit.width, "height": exhibit.height})

    async def show(request: Request) -> Response:
        exhibit = studio.exhibit(request.path_params["name"])
        what, view = request.path_params["what"], _view(request)
        if what == "after.jpg":
            data, target = await run_in_threadpool(exhibit.straight, view)
            shown = {} if target is None else {"X-Degrees-Across": f"{degrees_across(target):.2f}"}
            return Response(data, media_type="image/jpeg", headers=_PRIVATE | shown)
        stills = {
            "before.jpg": lambda: exhibit.before,
            "curves.jpg": lambda: exhibit.curves,
            "lines.jpg": lambda: exhibit.lines,
        }
        if what in stills:
            data = await run_in_threadpool(stills[what])
            if data is None:
                raise LookupError("This method makes no heatmap.")
            return Response(data, media_type="image/jpeg", headers=_PRIVATE)
        offer = offered(exhibit).get(what)
        if offer is None:
            raise LookupError("There is no such file.")
        data = await run_in_threadpool(make_file, exhibit, offer, view)
        kept = {"Content-Disposition": "attachment"}  # the browser knows the picture's name
        return Response(data, media_type=offer.media_type, headers=_PRIVATE | kept)

    return [
        Route("/pictures", _told(upload), methods=["POST"]),
        Route("/pictures/{name}/{what}", _told(show), methods=["GET"]),
    ]


async def _body(request: Request, max_bytes: int) -> bytes:
    """The request's body; the reading stops as soon as it is too large."""
    announced = request.headers.get("content-length", "0")
    if not announced.isdigit() or int(announced) > max_bytes:
        raise _TooLargeError
    data = bytearray()
    async for chunk in request.stream():
        data += chunk
        if len(data) > max_bytes:
            raise _TooLargeError
    return bytes(data)


def _view(request: Request) -> View:
    """The view that the address asks for."""
    chosen = {name: float(request.query_params[name]) for name in ("fov", "balance")
              if name in request.query_params}  # fmt: skip
    if not all(math.isfinite(value) for value in chosen.values()):
        raise ValueError("Expected finite numbers.")
    return View(**chosen)


def _told(handler: _Handler) -> _Handler:
    """What goes wrong is told in one line of JSON with the status that fits."""

    @wraps(handler)
    async def telling(request: Request) -> Response:
        try:
            return await handler(request)
        except _TooLargeError:
            return _complaint("The file is larger than this page takes.", 413)
        except LookupError as error:
            return _complaint(str(error), 404)
        except ValueError as error:
            return _complaint(str(error), 422)
        except MemoryError:
            return _complaint("Not enough memory for this picture.", 507)
        except ClientDisconnect:
            return _complaint("The upload was broken off.", 400)

    return telling


def _complaint(message: str, status: int) -> Response:
    return JSONResponse({"error": " ".join(message.split())}, status, headers=_PRIVATE)
