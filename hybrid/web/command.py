"""The command `straightlens serve`."""

from __future__ import annotations

import asyncio
import socket

import click

from hybrid.commands import options
from hybrid.commands.checks import misuse

_DEFAULT_HOST = "127.0.0.1"


@click.command()
@options.method
@click.option(
    "--host",
    default=_DEFAULT_HOST,
    show_default=True,
    help="Address to listen on. Anything but loopback lets others on the network use the page.",
)
@click.option(
    "--port", default=7860, show_default=True, type=click.IntRange(0, 65535), help="0: any."
)
@click.option("--max-mib", default=64.0, show_default=True, help="Largest file taken in, MiB.")
@click.option("--max-megapixels", default=50.0, show_default=True, help="Largest picture taken in.")
@options.threads
def serve(
    method: str, host: str, port: int, max_mib: float, max_megapixels: float, threads: int | None
) -> None:
    """Show a page to try it on: drop a picture, see it straight, take picture and camera.

    Pictures stay in the memory of this computer, and nothing is fetched from elsewhere. Ctrl-C
    stops it.
    """
    try:
        import uvicorn

        from hybrid.web.app import LOOPBACK, build_app
    except ImportError as error:
        raise click.ClickException(
            f"the page needs Gradio: pip install 'straightlens[web]' ({error})"
        ) from error
    from hybrid.web.studio import Studio
    from hybrid.web.upload import Limits

    with misuse():
        limits = Limits(max_bytes=round(max_mib * 2**20), max_pixels=round(max_megapixels * 1e6))
    listening = _listen(host, port)
    local = host in LOOPBACK
    where = f"http://{_in_url(host)}:{listening.getsockname()[1]}/"

    async def run() -> None:
        # the page is built inside the loop that serves it: Gradio ties locks to it
        app = build_app(Studio(limits, threads), method=method, hosts=LOOPBACK if local else ())
        config = uvicorn.Config(app, log_level="warning", server_header=False, ws="none")
        click.echo(f"{where}  (Ctrl-C stops)")
        if not local:
            click.echo("Others on the network can use this page.", err=True)
        await uvicorn.Server(config).serve(sockets=[listening])

    asyncio.run(run())


def _listen(host: str, port: int) -> socket.socket:
    """A socket at the address; taken addresses are told before anything loads."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        reason = error.strerror or str(error)
        raise click.ClickException(f"cannot listen on {host}:{port}: {reason}") from error


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host
