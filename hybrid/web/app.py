"""The web application: guard, picture routes, page."""

from __future__ import annotations

import os
from collections.abc import Collection

from fastapi import FastAPI
from starlette.types import ASGIApp

from hybrid.web.guard import Guard
from hybrid.web.routes import picture_routes
from hybrid.web.studio import Studio

LOOPBACK = ("127.0.0.1", "localhost", "::1")


def build_app(studio: Studio, *, method: str, hosts: Collection[str] = LOOPBACK) -> ASGIApp:
    """Put the application together.

    Args:
        studio: What does the work.
        method: The method that the page starts with.
        hosts: Names under which it answers; empty for any.
    """
    os.environ["GRADIO_ANALYTICS_ENABLED"] = "False"  # read when Gradio is imported
    import gradio as gr

    from hybrid.web.page import build_page, css, head, theme

    app = FastAPI(openapi_url=None, routes=picture_routes(studio))
    mounted = gr.mount_gradio_app(
        app,
        build_page(studio, method),
        path="/",
        theme=theme(),
        css=css(),
        head=head(),
        footer_links=[],
        show_error=False,
        ssr_mode=False,
        run_history=False,
        pwa=False,
        enable_monitoring=False,
        mcp_server=False,
    )
    return Guard(mounted, hosts)
