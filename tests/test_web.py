"""Laws of the page's server: limits on what comes in, nothing by path, whole files out."""

import asyncio
import io
import signal
import socket
import struct
import subprocess
import sys
import time
import urllib.request
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("gradio")
pytest.importorskip("fastapi")
from starlette.testclient import TestClient

from classical.camera import KannalaBrandt
from hybrid import Quality, read_camera
from hybrid.camera_files import format_names
from hybrid.cli import run
from hybrid.result import Calibration
from hybrid.web.app import build_app
from hybrid.web.downloads import offered
from hybrid.web.exhibit import Exhibit, View
from hybrid.web.numbers import lens_numbers, trust_lines
from hybrid.web.store import Store
from hybrid.web.studio import Studio
from hybrid.web.upload import Limits, picture_from_bytes

SIZE = (240, 180)
LENS = KannalaBrandt.centred(np.array([0.95, -0.06, 0.004, 0.0, 0.0]), *SIZE)
LIMITS = Limits(max_bytes=200_000, max_pixels=100_000, max_kept=3)


class KnownLens(Studio):
    """A studio whose every picture has one lens, so that nothing has to be looked for."""

    def find_lens(self, name: str, method: str) -> Exhibit:
        exhibit = self.exhibit(name)
        known = Calibration(LENS, ((),), Quality(), "ok", "known")
        known_exhibit = Exhibit(exhibit.picture, known)
        self._store.replace(name, known_exhibit)
        return known_exhibit


@pytest.fixture(scope="module")
def studio() -> Studio:
    return KnownLens(LIMITS)


@pytest.fixture(scope="module")
def app(studio):
    async def build():  # inside a loop, or Gradio opens some that it never closes
        return build_app(studio, method="classical")

    return asyncio.run(build())


@pytest.fixture(scope="module")
def client(app):
    return TestClient(app, base_url="http://127.0.0.1:7860", raise_server_exceptions=False)


def encoded(kind: str = "PNG", pixels: np.ndarray | None = None, **options) -> bytes:
    if pixels is None:
        u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
        pixels = np.stack([u % 256, v % 256, (u + v) % 256], axis=-1).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, kind, **options)
    return stream.getvalue()


def sent(client, data: bytes) -> str:
    answer = client.post("/pictures", content=data)
    assert answer.status_code == 200, answer.text
    return answer.json()["name"]


# ---- what comes in ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "TIFF", "BMP"])
def test_usual_pictures_are_taken_and_shown(client, kind):
    name = sent(client, encoded(kind))
    shown = client.get(f"/pictures/{name}/before.jpg")
    assert shown.headers["content-type"] == "image/jpeg"
    assert Image.open(io.BytesIO(shown.content)).size == SIZE


def claimed_size_bomb() -> bytes:
    """A PNG that says it has 60000 x 60000 pixels."""
    parts = [
        b"IHDR" + struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0),
        b"IDAT" + zlib.compress(b"\0" * 1000),
        b"IEND",
    ]
    chunks = [struct.pack(">I", len(p) - 4) + p + struct.pack(">I", zlib.crc32(p)) for p in parts]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


@pytest.mark.parametrize(
    ("data", "status", "message"),
    [
        (b"", 422, "JPEG, PNG"),
        (b"GIF89a and so on", 422, "JPEG, PNG"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", 422, "JPEG, PNG"),
        (b"<svg xmlns='http://www.w3.org/2000/svg'/>", 422, "JPEG, PNG"),
        (encoded("JPEG")[:500], 422, "runcated"),
        (b"\x89PNG\r\n\x1a\n and nonsense", 422, ""),
        (encoded(pixels=np.zeros((400, 400), np.uint8)), 422, "more than 100000 pixels"),
        (claimed_size_bomb(), 422, "more than 100000 pixels"),
        (b"\xff\xd8\xff" + bytes(300_000), 413, "larger"),
    ],
)
def test_what_is_no_picture_within_the_limits_is_refused_in_one_line(client, data, status, message):
    answer = client.post("/pictures", content=data)
    assert answer.status_code == status
    said = answer.json()["error"]
    assert message in said
    assert "\n" not in said
    assert "/" not in said.replace("TIFF or BMP", "")  # no path of the server


def test_an_upload_without_a_length_is_cut_off_at_the_limit(app):
    read, said = [], []

    async def receive():
        read.append(50_000)
        return {"type": "http.request", "body": b"\xff" * read[-1], "more_body": True}

    async def send(message):
        said.append(message)

    scope = {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": "POST",
        "scheme": "http",
        "path": "/pictures",
        "raw_path": b"/pictures",
        "query_string": b"",
        "root_path": "",
        "headers": [(b"host", b"localhost")],
        "client": ("127.0.0.1", 1),
        "server": ("127.0.0.1", 7860),
    }
    asyncio.run(app(scope, receive, send))
    assert said[0]["status"] == 413
    assert sum(read) <= LIMITS.max_bytes + 50_000


@pytest.mark.parametrize("length", ["-1", "many", "99999999999999"])
def test_a_false_length_is_refused(client, length):
    answer = client.post("/pictures", content=b"x", headers={"content-length": length})
    assert answer.status_code == 413


def test_limits_must_be_positive():
    with pytest.raises(ValueError, match="max_bytes > 0"):
        Limits(max_bytes=0)


def test_float_pictures_of_any_range_become_pictures():
    import tifffile

    stream = io.BytesIO()
    tifffile.imwrite(stream, np.full((20, 30), 7.5, np.float32))
    assert picture_from_bytes(stream.getvalue(), LIMITS).pixels.max() == 1.0


# ---- what goes out ----------------------------------------------------------------------------


@pytest.fixture
def found(client, studio) -> str:
    name = sent(client, encoded())
    studio.find_lens(name, "classical")
    return name


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_the_straight_picture_has_its_full_size(client, found, suffix):
    answer = client.get(f"/pictures/{found}/straight.{suffix}?fov=80")
    assert answer.headers["content-disposition"] == "attachment"
    assert Image.open(io.BytesIO(answer.content)).size == SIZE


def test_the_camera_file_is_the_lens(client, found, tmp_path):
    (tmp_path / "c.json").write_bytes(client.get(f"/pictures/{found}/camera.json").content)
    assert read_camera(tmp_path / "c.json").camera == LENS


@pytest.mark.parametrize("kind", sorted(set(format_names()) - {"division", "ocam"}))
def test_every_camera_format_is_offered_and_read_back(client, studio, found, tmp_path, kind):
    offers = offered(studio.exhibit(found)).values()
    (offer,) = (offer for offer in offers if offer.kind == kind)
    answer = client.get(f"/pictures/{found}/{offer.name}?fov=80")
    assert answer.status_code == 200, answer.text
    (tmp_path / offer.name).write_bytes(answer.content)
    np.testing.assert_allclose(read_camera(tmp_path / offer.name).camera.k, LENS.k, atol=1e-6)


def test_the_view_is_what_was_asked_for(client, found):
    def across(query: str) -> float:
        answer = client.get(f"/pictures/{found}/after.jpg?{query}")
        assert answer.status_code == 200
        return float(answer.headers["x-degrees-across"])

    assert across("fov=70") == pytest.approx(70, abs=0.01)
    assert across("balance=0") == pytest.approx(across(""), abs=0.01)
    assert across("balance=1") > across("balance=0.5") > across("balance=0")


@pytest.mark.parametrize(
    "query",
    ["fov=190", "fov=-1", "fov=x", "fov=nan", "balance=2", "balance=inf", "fov=80&balance=0"],
)
def test_a_view_that_cannot_be_is_refused(client, found, query):
    for what in ("after.jpg", "straight.png"):
        answer = client.get(f"/pictures/{found}/{what}?{query}")
        assert answer.status_code == 422
        assert answer.json()["error"]


def test_depth_is_kept(client, studio):
    deep = np.full((SIZE[1], SIZE[0]), 40000, np.uint16)
    name = sent(client, encoded(pixels=deep))
    studio.find_lens(name, "classical")
    pixels = np.asarray(
        Image.open(io.BytesIO(client.get(f"/pictures/{name}/straight.png").content))
    )
    assert abs(int(pixels[90, 120]) - 40000) < 3


def test_without_a_lens_there_is_nothing_to_take(client):
    name = sent(client, encoded())
    for what in ("straight.jpg", "camera.json", "lines.jpg"):
        assert client.get(f"/pictures/{name}/{what}").status_code == 404
    untouched = client.get(f"/pictures/{name}/after.jpg")
    assert untouched.content == client.get(f"/pictures/{name}/before.jpg").content


def test_nothing_is_cached_on_the_way(client, found):
    assert "no-store" in client.get(f"/pictures/{found}/before.jpg").headers["cache-control"]


# ---- who is let in ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "path",
    [
        "/gradio_api/file=/etc/passwd",
        "/gradio_api/file=pyproject.toml",
        "/file=/etc/passwd",
        "/gradio_api/proxy=http://example.org/",
        "/gradio_api/upload_progress",
        "/gradio_api/stream/a",
        "/gradio_api/openapi.json",
        "/gradio_api/vibe-code/",
        "/gradio_api/deep_link",
        "/monitoring",
        "/docs",
        "/login",
        "/assets/../routes.py",
        "/assets/..%2f..%2froutes.py",
        "/static/%2e%2e/routes.py",
        "/pictures/..%2f..%2f..%2fetc%2fpasswd/before.jpg",
        "/pictures/aaaaaaaaaaaaaaaaaaaaaa/..%2fbefore.jpg",
    ],
)
def test_addresses_that_the_page_does_not_need_do_not_exist(client, path):
    answer = client.get(path)
    assert answer.status_code == 404
    assert "root:" not in answer.text


@pytest.mark.parametrize("path", ["/gradio_api/upload", "/gradio_api/run/predict", "/login"])
def test_gradio_takes_no_files_and_no_calls_by_name(client, path):
    assert client.post(path, files={"files": b"x"}).status_code == 404


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS"])
def test_other_methods_are_refused(client, method):
    assert client.request(method, "/pictures").status_code == 404


def test_a_name_that_was_never_given_finds_nothing(client):
    answer = client.get("/pictures/aaaaaaaaaaaaaaaaaaaaaa/before.jpg")
    assert answer.status_code == 404
    assert "forgotten" in answer.json()["error"]


@pytest.mark.parametrize("host", ["evil.example", "evil.example:7860", "127.0.0.1.evil.example"])
def test_a_foreign_name_for_this_machine_is_refused(client, host):
    assert client.get("/", headers={"host": host}).status_code == 403


@pytest.mark.parametrize("host", ["localhost:7860", "127.0.0.1:7860", "[::1]:7860"])
def test_the_machine_itself_is_served(client, host):
    assert client.get("/", headers={"host": host}).status_code == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:9999"])
def test_another_page_cannot_send_pictures(client, origin):
    answer = client.post("/pictures", content=encoded(), headers={"origin": origin})
    assert answer.status_code == 403


def test_the_browser_is_told_to_fetch_from_here_only(client):
    policy = client.get("/").headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "http" not in policy


# ---- what is kept -----------------------------------------------------------------------------


def test_the_store_keeps_the_things_used_last():
    store: Store[str] = Store(max_kept=2, max_age=60.0)
    first, second = store.put("first"), store.put("second")
    assert store.get(first) == "first"
    store.put("third")
    assert store.get(second) is None
    assert store.get(first) == "first"


def test_the_store_forgets_by_age(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("hybrid.web.store.time.monotonic", lambda: now[0])
    store: Store[str] = Store(max_kept=9, max_age=60.0)
    name = store.put("thing")
    now[0] = 59
    assert store.get(name) == "thing"
    now[0] = 118
    assert store.get(name) == "thing"  # as it was looked at meanwhile
    now[0] = 179
    assert store.get(name) is None
    store.replace(name, "late")
    assert store.get(name) is None


# ---- numbers ----------------------------------------------------------------------------------


def test_deviations_are_those_of_a_simulation():
    rng = np.random.default_rng(0)
    spread = np.array([0.01, 0.004, 0.001, 2e-4, 5e-5, 0.0, 0.3, 0.5, 0.4])
    mixing = np.eye(9) + 0.2 * rng.normal(size=(9, 9))
    mixing[5] = 0
    factor = spread[:, None] * mixing
    told = lens_numbers(LENS, factor @ factor.T)
    draws = LENS.to_vector() + rng.normal(size=(1500, 9)) @ factor.T
    cameras = [KannalaBrandt.from_vector(draw, *SIZE) for draw in draws]
    values = [[n.value for n in lens_numbers(camera, np.zeros((9, 9)))] for camera in cameras]
    simulated = np.std(values, axis=0)
    deviations = np.array([n.deviation for n in told], dtype=float)
    np.testing.assert_allclose(deviations, simulated, rtol=0.1)


def test_an_unknown_covariance_is_not_told_as_certainty():
    numbers = lens_numbers(LENS, np.zeros((9, 9)))
    assert {number.deviation for number in numbers} == {None}
    assert {number.deviation_text() for number in numbers} == {"–"}


def test_the_field_of_view_is_left_out_where_the_lens_ends_inside_the_picture():
    short = KannalaBrandt.centred(np.array([0.9, -0.3, 0.0, 0.0, 0.0]), *SIZE)
    assert lens_numbers(short, np.eye(9))[0].name == "fx"


def test_trust_is_told_only_where_it_is_known():
    assert trust_lines(Calibration(LENS, ((),), Quality(), "ok", "")) == []
    quality = Quality(0.2, 9, 8, np.eye(9), 1.25, "prior", 0.1)
    words = dict(trust_lines(Calibration(LENS, ((),), quality, "ok", "")))
    assert words["straight curves"] == "8 of 9"
    assert words["off straight"] == "0.20 px rms"
    assert "10" in words["focal length from"]


# ---- the studio -------------------------------------------------------------------------------


def test_a_black_picture_fails_with_its_reason_and_stays():
    studio = Studio(LIMITS)
    name = studio.take(encoded(pixels=np.zeros((180, 240, 3), np.uint8)))
    exhibit = studio.find_lens(name, "classical")
    assert exhibit.found is not None
    assert exhibit.found.status == "failed"
    assert exhibit.straight(View())[0] == exhibit.before


def test_the_network_shows_where_it_sees_lines():
    studio = Studio(LIMITS)
    name = studio.take(encoded())
    exhibit = studio.find_lens(name, "learned")
    assert exhibit.lines is not None
    assert Image.open(io.BytesIO(exhibit.lines)).size == SIZE
    assert studio.find_lens(name, "classical").lines is None


def test_an_unknown_method_is_refused():
    studio = Studio(LIMITS)
    with pytest.raises(ValueError, match="magic"):
        studio.find_lens(studio.take(encoded()), "magic")


def test_assets_belong_to_the_package():
    import hybrid.web

    folder = Path(hybrid.web.__file__).with_name("assets")
    assert {path.suffix for path in folder.iterdir()} >= {".html", ".css", ".js"}
    for path in folder.iterdir():
        words = path.read_text(encoding="utf-8")
        assert "http://" not in words
        assert "https://" not in words


# ---- the command ------------------------------------------------------------------------------


def test_a_taken_port_is_one_line(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert run(["serve", "--port", port]) == 1
    said = capsys.readouterr().err
    assert f"cannot listen on 127.0.0.1:{port}" in said
    assert said.count("\n") == 1


def test_limits_that_make_no_sense_are_misuse(capsys):
    assert run(["serve", "--max-mib", "0"]) == 2
    assert "max_bytes > 0" in capsys.readouterr().err


def test_without_gradio_the_command_says_what_to_install(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert run(["serve"]) == 1
    assert "straightlens[web]" in capsys.readouterr().err


def test_the_command_serves_on_loopback_until_it_is_stopped():
    code = "import sys; from hybrid.cli import run; sys.exit(run(['serve', '--port', '0']))"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as server:
        assert server.stdout is not None
        where = server.stdout.readline().split()[0]
        assert where.startswith("http://127.0.0.1:")
        for _ in range(100):
            try:
                with urllib.request.urlopen(where) as page:
                    assert b"Straightlens" in page.read()
                break
            except OSError:
                time.sleep(0.1)
        else:
            pytest.fail("the page does not answer")
        server.send_signal(signal.SIGINT)
        _, said = server.communicate(timeout=60)
    assert server.returncode in (
        0,
        130,
    )  # started in the background, Python leaves SIGINT to the server
    assert "Traceback" not in said
