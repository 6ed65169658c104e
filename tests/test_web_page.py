"""Laws of the page as a browser shows it: what is dropped is seen straight, and nothing leaves."""

import asyncio
import base64
import io
import os
import shutil
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("gradio")
uvicorn = pytest.importorskip("uvicorn")
playwright = pytest.importorskip("playwright.sync_api")

from hybrid import read_camera
from hybrid.web.app import build_app
from hybrid.web.exhibit import Exhibit
from hybrid.web.studio import Studio
from hybrid.web.upload import Limits

ROOT = Path(__file__).resolve().parents[1]
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
SHOTS = ROOT / "out" / "page"  # screenshots, to be looked at
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
SIZE = (480, 360)
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # Gradio's, in its server
]


class CountingStudio(Studio):
    """Counts how often a lens was asked for; looks once a picture, as the tests share one."""

    def __init__(self, limits: Limits) -> None:
        super().__init__(limits)
        self.asked = 0
        self._seen: dict[tuple[str, bytes], Exhibit] = {}

    def find_lens(self, name: str, method: str) -> Exhibit:
        self.asked += 1
        key = method, self.exhibit(name).picture.pixels.tobytes()
        if key not in self._seen:
            self._seen[key] = super().find_lens(name, method)
        self._store.replace(name, self._seen[key])
        return self._seen[key]


@dataclass
class Watched:
    """A page with all that it asked for and complained about."""

    page: Any
    hosts: set[str] = field(default_factory=set)
    complaints: list[str] = field(default_factory=list)


@pytest.fixture(scope="module")
def studio() -> CountingStudio:
    return CountingStudio(Limits(max_bytes=2_000_000))


@pytest.fixture(scope="module")
def address(studio) -> Iterator[str]:
    """The address of a server in a thread of its own."""
    server = None
    ready = threading.Event()

    async def serve() -> None:
        nonlocal server
        app = build_app(studio, method="classical")
        config = uvicorn.Config(app, port=0, log_level="error", ws="none")
        server = uvicorn.Server(config)
        task = asyncio.create_task(server.serve())
        while not server.started:
            await asyncio.sleep(0.05)
        ready.set()
        await task

    thread = threading.Thread(target=lambda: asyncio.run(serve()), daemon=True)
    thread.start()
    assert ready.wait(60)
    assert server is not None
    port = server.servers[0].sockets[0].getsockname()[1]
    yield f"http://127.0.0.1:{port}/"
    server.should_exit = True
    thread.join(20)


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture
def watched(browser, address) -> Iterator[Watched]:
    yield from _open(browser, address, viewport={"width": 1400, "height": 950})


@pytest.fixture
def phone(browser, address) -> Iterator[Watched]:
    yield from _open(
        browser, address, viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True
    )


def _open(browser, address: str, **options) -> Iterator[Watched]:
    context = browser.new_context(**options)
    page = context.new_page()
    page.set_default_timeout(60_000)
    watched = Watched(page)
    page.on("request", lambda request: watched.hosts.add(request.url.split("/")[2]))
    page.on(
        "console",
        lambda said: watched.complaints.append(said.text) if said.type == "error" else None,
    )
    page.on("pageerror", lambda error: watched.complaints.append(str(error)))
    page.goto(address)
    page.wait_for_selector(".sl-drop")
    yield watched
    context.close()


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("pictures") / "my room.jpg"
    with Image.open(ROOT / "examples" / "room.jpg") as image:
        image.resize(SIZE, Image.Resampling.BOX).save(path, quality=92)
    return path


@pytest.fixture
def photograph() -> Path:
    """A picture as it comes from a camera; the example unless one of yours is named."""
    return Path(os.environ.get("STRAIGHTLENS_PHOTOGRAPH") or ROOT / "examples" / "room.jpg")


def drop(page, path: Path) -> None:
    """Give a picture and wait for its report."""
    page.set_input_files(".sl-drop input", path)
    page.wait_for_selector("#sl-report .sl-status:not(.sl-busy)")


def share_of_black(picture: np.ndarray) -> float:
    return float((picture.max(axis=2) < 6).mean())


def pixels(page, which: str) -> np.ndarray:
    """The pixels of a picture on the page, as the browser decoded them."""
    page.wait_for_function(
        """name => {
             const image = document.querySelector(name);
             return image.complete && image.naturalWidth > 0;
           }""",
        arg=which,
    )
    data = page.evaluate(
        """name => {
             const image = document.querySelector(name);
             const canvas = document.createElement("canvas");
             canvas.width = image.naturalWidth;
             canvas.height = image.naturalHeight;
             canvas.getContext("2d").drawImage(image, 0, 0);
             return canvas.toDataURL("image/png").split(",")[1];
           }""",
        which,
    )
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")).astype(int)


def caption(page, words: str) -> str:
    """The caption once it contains the words."""
    page.wait_for_function(
        "words => document.querySelector('.sl-caption').textContent.includes(words)", arg=words
    )
    return page.inner_text(".sl-caption")


def shot(page, name: str) -> None:
    SHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SHOTS / f"{name}.png", full_page=True)


def test_a_dropped_picture_is_seen_before_and_after(watched, room):
    page = watched.page
    drop(page, room)
    caption(page, "framed by balance 0")
    before, after = pixels(page, ".sl-before"), pixels(page, ".sl-after")
    with Image.open(room) as image:
        assert np.abs(before - np.asarray(image)).mean() < 4
    assert before.shape == after.shape
    assert np.abs(before - after).mean() > 10
    assert page.locator(".sl-ok").is_visible()
    numbers = page.inner_text(".sl-numbers")
    assert "field of view across" in numbers
    assert numbers.count("±") == 9
    shot(page, "desktop")
    assert watched.complaints == []


def test_a_whole_photograph_is_seen_by_the_default_method(watched, photograph):
    page = watched.page
    page.get_by_label("How the lens is found").click()
    page.get_by_role("option", name="hybrid").click()
    drop(page, photograph)
    caption(page, "framed by balance 0")
    before, after = pixels(page, ".sl-before"), pixels(page, ".sl-after")
    assert before.shape == after.shape
    assert np.abs(before - after).mean() > 5
    shot(page, "photograph")
    for tab in ("curves", "lines"):  # both are there: this method has a heatmap
        page.click(f"[data-tab={tab}]")
        assert pixels(page, ".sl-still").shape[2] == 3
        shot(page, f"photograph_{tab}")
    assert watched.complaints == []


def test_the_slider_uncovers_the_picture_as_it_came(watched, room):
    page = watched.page
    drop(page, room)
    slide = page.locator(".sl-slide")
    slide.focus()
    for _ in range(20):
        page.keyboard.press("ArrowRight")
    assert float(slide.input_value()) == 60
    clip = page.eval_on_selector(".sl-before", "image => getComputedStyle(image).clipPath")
    assert clip.startswith("inset(0px calc(40%") or "40%" in clip


def test_another_view_is_warped_without_another_look(watched, room, studio):
    page = watched.page
    drop(page, room)
    caption(page, "framed by balance 0")
    asked, first = studio.asked, pixels(page, ".sl-after")
    balance = page.locator("#sl-balance input[type=range]")
    balance.focus()
    for _ in range(20):
        page.keyboard.press("ArrowRight")
    caption(page, "framed by balance 1")
    dark = share_of_black(first) + 0.1  # where nothing of the picture lies
    for _ in range(100):  # the picture follows the slider's last place after those before it
        if share_of_black(pixels(page, ".sl-after")) > dark:
            break
        page.wait_for_timeout(100)
    else:
        pytest.fail("balance 1 shows no black")
    fov = page.locator("#sl-fov input[type=number]")
    fov.fill("60")
    fov.press("Enter")
    assert caption(page, "60.0°") == "Shows 60.0° across."
    assert np.abs(pixels(page, ".sl-after") - first).mean() > 5
    assert studio.asked == asked


def test_curves_are_shown_in_colour(watched, room):
    page = watched.page
    drop(page, room)
    page.click("[data-tab=curves]")
    drawn = pixels(page, ".sl-still")
    spread = drawn.max(axis=2) - drawn.min(axis=2)
    before = pixels(page, ".sl-before")
    assert spread.mean() > 1.15 * (before.max(axis=2) - before.min(axis=2)).mean()
    assert not page.locator("[data-tab=lines]").is_visible()  # this method asks no network
    shot(page, "curves")


def test_files_are_taken_under_the_name_of_the_picture(watched, room, tmp_path):
    page = watched.page
    drop(page, room)
    caption(page, "framed by balance 0")
    for what in ("straight.png", "camera.json"):
        with page.expect_download() as wait:
            page.click(f"a[data-file='{what}']")
        assert wait.value.suggested_filename == f"my room.{what}"
        wait.value.save_as(tmp_path / what)
    with Image.open(tmp_path / "straight.png") as straight:
        assert straight.size == SIZE
        seen = np.asarray(straight.convert("RGB")).astype(int)
    assert np.abs(seen - pixels(page, ".sl-after")).mean() < 4
    assert read_camera(tmp_path / "camera.json").camera.width == SIZE[0]


def test_what_is_no_picture_is_refused_and_the_page_goes_on(watched, room, tmp_path):
    page = watched.page
    (tmp_path / "notes.jpg").write_text("these are notes")
    page.set_input_files(".sl-drop input", tmp_path / "notes.jpg")
    page.wait_for_selector(".sl-complaint:not([hidden])")
    assert "Expected a JPEG, PNG, WebP, TIFF or BMP" in page.inner_text(".sl-complaint")
    (tmp_path / "large.jpg").write_bytes(bytes(3_000_000))
    page.set_input_files(".sl-drop input", tmp_path / "large.jpg")
    page.wait_for_function(
        "() => document.querySelector('.sl-complaint').textContent.includes('larger')"
    )
    drop(page, room)
    assert not page.locator(".sl-complaint").is_visible()


def test_a_picture_without_lines_is_told_and_shown_as_it_is(watched, tmp_path):
    page = watched.page
    Image.new("RGB", SIZE, (90, 120, 90)).save(tmp_path / "plain.png")
    drop(page, tmp_path / "plain.png")
    assert page.locator(".sl-failed").is_visible()
    assert "No lens" in caption(page, "No lens")
    assert page.locator("a.sl-file").count() == 0
    assert not page.locator("#sl-fov").is_visible()


def test_nothing_is_asked_of_any_other_machine(watched, room, address):
    page = watched.page
    drop(page, room)
    page.click("[data-tab=curves]")
    page.wait_for_load_state("networkidle")
    assert watched.hosts == {address.split("/")[2]}


def test_a_phone_shows_all_of_it_without_sideways_scrolling(phone, room):
    page = phone.page
    drop(page, room)
    caption(page, "framed by balance 0")
    pixels(page, ".sl-after")
    assert page.evaluate("document.scrollingElement.scrollWidth") <= 390
    stage = page.locator(".sl-stage").bounding_box()
    assert stage["width"] > 300
    shot(page, "phone")
    assert phone.complaints == []
