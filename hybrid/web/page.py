"""The page itself, laid out with Gradio; its pictures and files come from `hybrid.web.routes`."""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import gradio as gr
from gradio.themes import Base, Default

from hybrid.camera_files import OWN_FORMAT
from hybrid.methods import METHODS
from hybrid.web.downloads import Offer, offered
from hybrid.web.exhibit import Exhibit, View, degrees_across
from hybrid.web.numbers import lens_numbers, trust_lines
from hybrid.web.studio import Studio
from hybrid.web.upload import Limits

_ASSETS = Path(__file__).with_name("assets")
_WIDEST = 170  # degrees
_N_SHOWN = 6  # components that a picture changes
_SYSTEM_FONTS = ["system-ui", "sans-serif"]  # of this computer: nothing is fetched


def theme() -> Base:
    """Quiet, with fonts of the computer at hand."""
    plain = Default(
        primary_hue="teal", neutral_hue="slate", font=_SYSTEM_FONTS, font_mono=["monospace"]
    )
    return plain.set(body_text_color_subdued="*neutral_500")  # dark enough to be read on white


def head() -> str:
    """The script of the page, put into its head."""
    return f"<script>{_asset('page.js')}</script>"


def css() -> str:
    """The style of the page."""
    return _asset("page.css")


def build_page(studio: Studio, method: str) -> gr.Blocks:
    """Lay the page out and wire it.

    Args:
        studio: What does the work.
        method: The method chosen at first.
    """
    with gr.Blocks(title="Straightlens", analytics_enabled=False) as page:
        gr.HTML(_asset("title.html"), elem_id="sl-title", apply_default_css=False)
        with gr.Row(elem_id="sl-main"):
            with gr.Column(scale=5, min_width=320, visible=False) as shown:
                viewer = gr.HTML(
                    html_template=_asset("viewer.html"),
                    js_on_load="straightlens.viewer(element, props, watch)",
                    elem_id="sl-viewer",
                    apply_default_css=False,
                )
                with gr.Row(visible=False) as frame:
                    fov = gr.Slider(
                        20, _WIDEST, 90, step=1, label="Field of view, degrees", elem_id="sl-fov"
                    )
                    balance = gr.Slider(
                        0, 1, 0, step=0.05, label="Balance: 0 fills the frame, 1 keeps all",
                        elem_id="sl-balance",
                    )  # fmt: skip
            with gr.Column(scale=2, min_width=320):
                drop = gr.HTML(
                    html_template=_drop(studio.limits),
                    js_on_load="straightlens.drop(element, props, trigger, 'picture')",
                    elem_id="sl-drop",
                    apply_default_css=False,
                )
                chosen = gr.Dropdown(
                    [(f"{row.name}: {row.title}", row.name) for row in METHODS],
                    value=method,
                    label="How the lens is found",
                    filterable=False,
                )
                report = gr.HTML(elem_id="sl-report", apply_default_css=False)

        shows = [shown, viewer, frame, fov, balance, report]
        quiet: dict[str, Any] = {"show_progress": "hidden", "api_visibility": "private"}
        for happens in (drop.picture, chosen.input):
            happens(partial(_show, studio), drop, shows, **quiet).then(
                partial(_look, studio), [drop, chosen], shows, concurrency_limit=1, **quiet
            )
        for slider, option in ((fov, "fov"), (balance, "balance")):
            js = f"(value) => straightlens.frame('{option}', value)"  # gives the degrees shown
            slider.input(None, slider, fov, js=js, **quiet)
    return page


def _show(studio: Studio, name: str | None) -> tuple[Any, ...]:
    """The picture as it came, at once: column, viewer, frame, two sliders and report."""
    skip = gr.skip()
    try:
        exhibit = studio.exhibit(name or "")
    except LookupError:
        return (skip,) * _N_SHOWN
    viewer = _viewer_value(name or "", exhibit, busy=True)
    wait = _status("busy", "looking for the lens", "this takes some seconds")
    return gr.Column(visible=True), viewer, gr.Row(visible=False), skip, skip, wait


def _look(studio: Studio, name: str | None, method: str) -> tuple[Any, ...]:
    """What is found out about the picture, for the same components as `_show`."""
    skip = gr.skip()
    if not name:
        return (skip,) * _N_SHOWN
    try:
        exhibit = studio.find_lens(name, method)
        frame = gr.Row(visible=exhibit.camera is not None)
        view = gr.Slider(value=round(_degrees(exhibit)))
        viewer = _viewer_value(name, exhibit, busy=False)
        return skip, viewer, frame, view, gr.Slider(value=0), _report(name, exhibit)
    except (LookupError, ValueError, MemoryError) as error:
        words = "not enough memory" if isinstance(error, MemoryError) else str(error)
        return skip, skip, skip, skip, skip, _status("failed", "failed", words)


def _degrees(exhibit: Exhibit) -> float:
    """What the first view shows, degrees across."""
    camera = exhibit.camera
    return 90.0 if camera is None else degrees_across(View().target(camera))


def _viewer_value(name: str, exhibit: Exhibit, *, busy: bool) -> dict[str, Any]:
    """What the viewer's script needs to know."""
    found = exhibit.found
    return {
        "name": name,
        "busy": busy,
        "width": exhibit.width,
        "height": exhibit.height,
        "lens": exhibit.camera is not None and not busy,
        "curves": found is not None and bool(found.curves[0]) and not busy,
        "lines": exhibit.heatmap is not None and not busy,
    }


def _report(name: str, exhibit: Exhibit) -> str:
    """Status, numbers and files of a picture whose lens was looked for."""
    found = exhibit.found
    assert found is not None
    parts = [_status(found.status, found.status, found.reason)]
    if found.camera is not None:
        parts.append(_links(name, offered(exhibit).values()))
    trust = "".join(
        f"<tr><th>{escape(what)}</th><td colspan=2>{escape(words)}</td></tr>"
        for what, words in trust_lines(found)
    )
    if trust:
        parts.append(f"<h2>How far to trust it</h2><table>{trust}</table>")
    if found.camera is not None:
        rows = "".join(
            f"<tr><th>{number.name}</th><td>{number.text()}</td>"
            f"<td>{number.deviation_text()}</td></tr>"
            for number in lens_numbers(found.camera, found.quality.covariance)
        )
        parts.append(
            "<h2>The lens, as <code>cv2.fisheye</code> takes it</h2>"
            f"<table class=sl-numbers>{rows}</table>"
            "<p class=sl-note>± is one standard deviation.</p>"
        )
    return "".join(parts)


def _status(kind: str, head: str, words: str) -> str:
    return (
        f'<p class="sl-status sl-{kind}" role=status><strong>{escape(head)}</strong> '
        f"{escape(words)}</p>"
    )


def _links(name: str, offers: Collection[Offer]) -> str:
    """Links to the files: the pictures, our camera file, and the other formats folded away."""
    own = [offer for offer in offers if offer.kind in (None, OWN_FORMAT)]
    others = [offer for offer in offers if offer not in own]
    rows = "".join(
        f"<li>{_link(name, offer, offer.kind or '')} <small>{escape(offer.title)}</small></li>"
        for offer in others
    )
    short = "".join(
        _link(name, offer, f"Picture, {offer.title}" if offer.kind is None else "Camera, JSON")
        for offer in own
    )
    return (
        f"<h2>Take it with you</h2><p class=sl-files>{short}</p>"
        f"<details><summary>Camera for other programs</summary><ul>{rows}</ul></details>"
    )


def _link(name: str, offer: Offer, words: str) -> str:
    return (
        f'<a class=sl-file data-file="{offer.name}" href="pictures/{name}/{offer.name}" '
        f'download="{offer.name}">{escape(words)}</a>'
    )


def _drop(limits: Limits) -> str:
    """The place to drop a picture, with the limits in words."""
    size = f"{limits.max_bytes / 2**20:g} MiB, {limits.max_pixels / 1e6:g} megapixels"
    page = _asset("drop.html").replace("LIMITS", size)
    return page.replace("MAX_BYTES", str(limits.max_bytes))


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")
