"""Films: every frame straight, times and sound kept, whole files or none."""

import json
import subprocess
import sys
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from classical.camera import KannalaBrandt, Pinhole
from classical.warp import remap, undistort_maps
from hybrid import CameraFile, Quality, Rectifier, RectifyConfig, read_camera, read_picture, rectify
from hybrid import write_camera as write_camera_file
from hybrid.cli import run
from hybrid.video import Encoding, Film, chosen_frames, rectify_film
from hybrid.video.display import Display

av = pytest.importorskip("av")

WIDTH, HEIGHT, RATE = 320, 176, 20
LENS = KannalaBrandt.centred(np.array([0.85, -0.05, 0.004, 0.0, 0.0]), WIDTH, HEIGHT)
FINE = Encoding(crf=4)
EXACT = RectifyConfig(antialias=False)


@cache
def view(turn: float) -> np.ndarray:
    """Dark bars on a wall 1 m ahead, the camera turned by so many radians."""
    u, v = np.meshgrid(np.arange(2 * WIDTH) / 2 - 0.25, np.arange(2 * HEIGHT) / 2 - 0.25)
    rays, _ = LENS.unproject(np.stack([u.ravel(), v.ravel()], axis=1))
    x, y, z = rays.T
    x, z = x * np.cos(turn) + z * np.sin(turn), z * np.cos(turn) - x * np.sin(turn)
    x, y = x / np.maximum(z, 1e-2), y / np.maximum(z, 1e-2)
    bars = ((x / 0.5) % 1 < 0.25) | (((y + 0.2 * x) / 0.4) % 1 < 0.2)
    grey = np.where(bars, 60.0, 190.0).reshape(HEIGHT, 2, WIDTH, 2).mean(axis=(1, 3))
    colours = np.array([1.0, 0.9, 0.7])  # so that colour planes matter, too
    return np.rint(grey[..., None] * colours).astype(np.uint8)


def write_film(
    path: Path,
    pictures: list[np.ndarray],
    *,
    times: list[int] | None = None,
    sound: bool = True,
    pixel_format: str = "yuv420p",
    rotation: int = 0,
    pixel_aspect: Fraction = Fraction(1),
) -> Path:
    """A film of RGB pictures; times are in milliseconds."""
    with av.open(str(path), "w") as out:
        video = out.add_stream("libx264", rate=RATE, options={"crf": "4", "preset": "ultrafast"})
        video.height, video.width = pictures[0].shape[:2]
        video.pix_fmt = pixel_format
        video.codec_context.time_base = Fraction(1, 1000)
        video.codec_context.sample_aspect_ratio = pixel_aspect
        if rotation:
            video.set_display_rotation(rotation)
        audio = out.add_stream("aac", rate=16000, layout="mono") if sound else None
        for i, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts = times[i] if times else i * 1000 // RATE
            frame.time_base = Fraction(1, 1000)
            out.mux(video.encode(frame))
        out.mux(video.encode(None))
        if audio is not None:
            tone = np.sin(np.arange(16000 * len(pictures) // RATE) * 0.17).astype(np.float32)
            for start in range(0, len(tone) - 1023, 1024):
                part = tone[None, start : start + 1024]
                samples = av.AudioFrame.from_ndarray(part, format="fltp", layout="mono")
                samples.sample_rate, samples.pts = 16000, start
                out.mux(audio.encode(samples))
            out.mux(audio.encode(None))
    return path


def panned(path: Path, count: int = 12, **options) -> Path:
    return write_film(path, [view(0.4 * i / count - 0.2) for i in range(count)], **options)


def seconds_of(path: Path) -> list[float]:
    with Film(path) as film:
        return [film.seconds(frame) for frame in film.frames()]


def pictures_of(path: Path) -> list[np.ndarray]:
    with Film(path) as film:
        return [film.picture(frame) for frame in film.frames()]


def sound_of(path: Path) -> list[tuple[Fraction, bytes]]:
    with av.open(str(path)) as film:
        packets = [packet for packet in film.demux(audio=0) if packet.dts is not None]
        return [(packet.pts * packet.time_base, bytes(packet)) for packet in packets]


def difference(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.abs(one.astype(int) - other).mean())


# ---- a whole film --------------------------------------------------------------------------------


def test_every_frame_is_the_picture_made_straight(tmp_path):
    source = panned(tmp_path / "in.mp4")
    report = rectify_film(source, tmp_path / "out.mp4", LENS, config=EXACT, encoding=FINE)
    before, after = pictures_of(source), pictures_of(tmp_path / "out.mp4")
    assert report.n_frames == len(after) == 12
    assert report.n_broken == 0
    for picture, straight in zip(before, after, strict=True):
        expected = rectify(picture, EXACT, camera=LENS).image
        assert difference(straight, expected) < 2
        assert difference(straight, picture) > 10


def test_sound_is_copied_packet_by_packet(tmp_path):
    source = panned(tmp_path / "in.mp4", 20)
    rectify_film(source, tmp_path / "out.mp4", LENS)
    expected = sound_of(source)
    assert len(expected) > 10
    assert sound_of(tmp_path / "out.mp4") == expected


def test_a_silent_film_stays_silent(tmp_path):
    rectify_film(panned(tmp_path / "in.mkv", sound=False), tmp_path / "out.mkv", LENS)
    with av.open(str(tmp_path / "out.mkv")) as film:
        assert len(film.streams) == 1


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".mov"])
def test_uneven_frame_times_are_kept(tmp_path, suffix):
    times = [0, 50, 90, 300, 310, 333, 900, 1000, 1017, 1400, 1450, 2000]
    source = panned(tmp_path / f"in{suffix}", times=times)
    out = tmp_path / f"out{suffix}"
    rectify_film(source, out, LENS)
    np.testing.assert_allclose(seconds_of(out), np.array(times) / 1000, atol=1e-6)


@pytest.mark.parametrize("rotation", [90, 180, -90])
def test_a_film_stored_on_its_side_becomes_upright(tmp_path, rotation):
    lying = [np.rot90(view(0.1 * i), -rotation // 90).copy() for i in range(4)]
    source = write_film(tmp_path / "in.mp4", lying, rotation=rotation)
    with Film(source) as film:
        assert film.display.size == (WIDTH, HEIGHT)
    assert difference(pictures_of(source)[2], view(0.1 * 2)) < 3
    rectify_film(source, tmp_path / "out.mp4", LENS, config=EXACT, encoding=FINE)
    with Film(tmp_path / "out.mp4") as film:
        assert film.display == Display(WIDTH, HEIGHT)
    straight = pictures_of(tmp_path / "out.mp4")[2]
    assert difference(straight, rectify(view(0.1 * 2), EXACT, camera=LENS).image) < 4


def test_squeezed_pixels_become_square(tmp_path):
    squeezed = [view(0.1 * i)[:, ::2].copy() for i in range(3)]
    source = write_film(tmp_path / "in.mp4", squeezed, pixel_aspect=Fraction(2))
    rectify_film(source, tmp_path / "out.mp4", LENS, config=EXACT, encoding=FINE)
    with Film(tmp_path / "out.mp4") as film:
        assert film.display == Display(WIDTH, HEIGHT)
    straight = pictures_of(tmp_path / "out.mp4")[1]
    assert difference(straight, rectify(view(0.1), EXACT, camera=LENS).image) < 8


@pytest.mark.parametrize("name", ["yuv420p", "yuv422p", "yuv444p", "yuvj420p", "yuv420p10le"])
def test_depth_and_colour_resolution_are_kept(tmp_path, name):
    source = panned(tmp_path / "in.mp4", 3, pixel_format=name)
    wide = RectifyConfig(balance=1.0, antialias=False)  # with black corners
    rectify_film(source, tmp_path / "out.mp4", LENS, config=wide, encoding=FINE)
    with Film(tmp_path / "out.mp4") as film:
        assert film.pixel_format == name
    before, after = pictures_of(source)[1], pictures_of(tmp_path / "out.mp4")[1]
    expected = rectify(before, wide, camera=LENS)
    assert not expected.valid.all()
    assert difference(after, expected.image) < 3
    assert after[~expected.valid].mean() < 10


def test_the_size_can_be_chosen_but_not_odd(tmp_path):
    source = panned(tmp_path / "in.mp4", 3)
    rectify_film(source, tmp_path / "out.mp4", LENS, config=RectifyConfig(size=(200, 100)))
    assert pictures_of(tmp_path / "out.mp4")[0].shape == (100, 200, 3)
    with pytest.raises(ValueError, match="even size"):
        rectify_film(source, tmp_path / "odd.mp4", LENS, config=RectifyConfig(size=(201, 100)))
    assert not (tmp_path / "odd.mp4").exists()


def test_a_camera_of_another_resolution_fits(tmp_path):
    source = panned(tmp_path / "in.mp4", 3)
    for name, lens in (("one", LENS), ("two", LENS.resized(2 * WIDTH, 2 * HEIGHT))):
        rectify_film(source, tmp_path / f"{name}.mp4", lens, encoding=FINE)
    one, two = (pictures_of(tmp_path / f"{name}.mp4")[1] for name in ("one", "two"))
    assert difference(one, two) < 0.2
    with pytest.raises(ValueError, match="shaped like"):
        rectify_film(source, tmp_path / "x.mp4", LENS.resized(WIDTH, 2 * HEIGHT))


def test_broken_packets_are_left_out_and_counted(tmp_path):
    source = panned(tmp_path / "in.mkv", 40, sound=False)
    data = bytearray(source.read_bytes())
    with av.open(str(source)) as film:
        places = [(p.pos, p.size) for p in film.demux(video=0) if p.size]
    position, size = places[len(places) // 2]
    data[position + 12 : position + size] = b"\xff" * (size - 12)
    source.write_bytes(data)
    report = rectify_film(source, tmp_path / "out.mkv", LENS)
    assert 30 <= report.n_frames <= 40
    assert len(pictures_of(tmp_path / "out.mkv")) == report.n_frames


# ---- whole files or none -------------------------------------------------------------------------


class StoppedError(Exception):
    pass


@pytest.mark.parametrize("error", [StoppedError, KeyboardInterrupt])
def test_a_film_that_is_stopped_leaves_nothing(tmp_path, error):
    def stop(done: int, total: int | None) -> None:
        assert total == 12
        if done == 5:
            raise error

    source = panned(tmp_path / "in.mp4")
    (tmp_path / "out").mkdir()
    with pytest.raises(error):
        rectify_film(source, tmp_path / "out" / "out.mp4", LENS, progress=stop)
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("name", ["out.webm", "out.nothing"])
def test_a_container_that_cannot_hold_it_is_told(tmp_path, name):
    source = panned(tmp_path / "in.mp4", 2)
    with pytest.raises(ValueError, match=name):
        rectify_film(source, tmp_path / name, LENS)
    assert [path.name for path in tmp_path.iterdir()] == ["in.mp4"]


def test_what_is_no_film_is_told(tmp_path):
    (tmp_path / "text.mp4").write_text("I am no film")
    with pytest.raises(ValueError, match=r"text\.mp4"):
        Film(tmp_path / "text.mp4")
    with pytest.raises(FileNotFoundError):
        Film(tmp_path / "none.mp4")
    sound = tmp_path / "sound.mp4"
    with av.open(str(sound), "w") as out:
        audio = out.add_stream("aac", rate=16000, layout="mono")
        silence = np.zeros((1, 1024), np.float32)
        samples = av.AudioFrame.from_ndarray(silence, format="fltp", layout="mono")
        samples.sample_rate = 16000
        out.mux(audio.encode(samples))
        out.mux(audio.encode(None))
    with pytest.raises(ValueError, match=r"sound\.mp4: no video"):
        Film(sound)


def test_a_missing_package_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ValueError, match=r"straightlens\[video\]"):
        Film(tmp_path / "any.mp4")


def test_importing_the_package_does_not_import_av():
    code = "import sys, hybrid.video; print('av' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


# ---- how frames are shown ------------------------------------------------------------------------


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("aspect", [1.0, 2.0])
def test_stored_maps_show_what_upright_shows(turns, aspect):
    rng = np.random.default_rng(0)
    stored = rng.integers(0, 255, (30, 40), np.uint8)
    display = Display(40, 30, turns, aspect)
    width, height = display.size
    maps = undistort_maps(*[Pinhole.centred(50.0, width, height)] * 2)
    shown = remap(stored, display.stored_maps(maps, (1, 1), (0.0, 0.0)), antialias=False)
    assert shown.shape == display.upright(stored).shape
    if aspect == 1:
        np.testing.assert_array_equal(shown, display.upright(stored))


@pytest.mark.parametrize("turns", range(4))
def test_colour_samples_are_taken_at_their_own_place(turns):
    # planes that hold where in the stored frame their samples lie: even columns, between rows
    display = Display(64, 48, turns)
    width, height = display.size
    target = Pinhole.centred(50.0, width, height)
    sparse = Pinhole(25.0, 25.0, target.u0 / 2, (target.v0 - 0.5) / 2, width // 2, height // 2)
    maps = display.stored_maps(undistort_maps(target, sparse), (2, 2), (0.0, 0.5))
    rows, columns = np.indices((24, 32)).astype(np.float32)
    found = [remap(plane, maps, antialias=False) for plane in (2 * columns, 2 * rows + 0.5)]
    places = display.upright(np.moveaxis(np.indices((48, 64))[::-1], 0, -1).astype(np.float32))
    expected = (places[::2, ::2] + places[1::2, ::2]) / 2
    error = np.abs(np.stack(found, axis=-1) - expected)[2:-2, 2:-2]
    assert error.max() < 1e-3


# ---- which frames --------------------------------------------------------------------------------


def test_sharp_frames_with_new_lines_are_chosen(tmp_path):
    flat = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
    left, right = flat.copy(), flat.copy()
    left[:, : WIDTH // 2] = view(0.0)[:, : WIDTH // 2]
    right[:, WIDTH // 2 :] = view(0.0)[:, WIDTH // 2 :]
    kinds = [left] * 20 + [flat] * 20 + [right] * 20
    source = write_film(tmp_path / "in.mp4", kinds, sound=False)
    with Film(source) as film:
        times = [time for time, _ in chosen_frames(film)]
    assert any(time < 1 for time in times)
    assert any(time >= 2 for time in times)
    assert not any(1 <= time < 2 for time in times)
    assert len(times) <= 4  # frames that show the same are of no use


def test_seeking_finds_the_frames_of_a_long_film(tmp_path):
    times = [i * 250 for i in range(200)]  # 50 s, with few key frames
    source = write_film(tmp_path / "in.mp4", [view(0.1 * (i % 4)) for i in range(200)], times=times)
    with Film(source) as film:
        bursts = list(film.frames_from([1.0, 20.0, 21.0, 49.6], 2))
        found = [[round(film.seconds(frame), 3) for frame in burst] for burst in bursts]
    assert found == [[1.0, 1.25], [20.0, 20.25], [21.0, 21.25], [49.75]]


# ---- the command line ----------------------------------------------------------------------------


@pytest.fixture
def lens_file(tmp_path) -> Path:
    write_camera_file(tmp_path / "lens.json", CameraFile(LENS, "ok", "made up", Quality()))
    return tmp_path / "lens.json"


def test_the_command_calibrates_and_straightens(tmp_path, capsys):
    source = panned(tmp_path / "in.mp4", 24)
    out = tmp_path / "new"
    options = ["--save-camera", str(out / "lens.yaml"), "--format", "opencv", "--json"]
    options += ["--preview", str(out / "frame.png"), "--at", "0.5", "--method", "classical"]
    assert run(["video", str(source), str(out / "out.mp4"), *options]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["n_frames"] == 24
    assert set(report["busy_seconds"]) == {"decode", "warp", "encode"}
    assert report["frames_used"]
    camera = read_camera(out / "lens.yaml").camera
    np.testing.assert_allclose(camera.k, report["camera"]["k"], rtol=1e-12)
    # straightness is what counts: the bars of the preview are those of the true lens, up to scale
    frame = pictures_of(source)[10]
    expected = Rectifier(RectifyConfig()).rectify(frame, camera=camera).image
    assert difference(read_picture(out / "frame.png").pixels, expected) < 0.5


def test_the_command_takes_a_camera(tmp_path, lens_file, capsys):
    source = panned(tmp_path / "in.mp4", 5)
    options = ["--camera", str(lens_file), "--preset", "ultrafast", "--codec", "h265"]
    assert run(["video", str(source), str(tmp_path / "out.mp4"), *options]) == 0
    said = capsys.readouterr()
    assert "5 frames" in said.out
    assert len(pictures_of(tmp_path / "out.mp4")) == 5
    assert run(["video", str(source), str(tmp_path / "out.mp4"), *options]) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_a_film_without_lines_fails_on_one_line(tmp_path, capsys):
    grey = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    source = write_film(tmp_path / "in.mp4", [grey] * 5)
    assert run(["video", str(source), str(tmp_path / "out.mp4"), "--method", "classical"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "in.mp4" in said
    assert not (tmp_path / "out.mp4").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["in.mp4"], 2, "nothing to do"),
        (["none.mp4", "out.mp4"], 2, "none.mp4"),
        (["in.mp4", "in.mp4", "--overwrite"], 2, "is an input"),
        (["in.mp4", "lens.json", "--overwrite"], 2, "is an input"),
        (["in.mp4", "out.mp4", "--preview", "out.mp4"], 2, "same name"),
        (["in.mp4", "--preview", "frame.mp4"], 2, "frame.png"),
        (["in.mp4", "--preview", "frame.png", "--at", "99"], 1, "no frame at 99"),
        (["in.mp4", "out.mp4", "--preset", "warp"], 2, "warp"),
        (["in.mp4", "out.mp4", "--crf", "60"], 2, "60"),
        (["in.mp4", "out.mp4", "--size", "201x99"], 1, "even size"),
        (["lens.json", "out.mp4"], 1, "lens.json"),
    ],
)
def test_misuse_is_one_line(tmp_path, lens_file, monkeypatch, capsys, arguments, code, message):
    panned(tmp_path / "in.mp4", 3)
    monkeypatch.chdir(tmp_path)
    assert run(["video", *arguments, "--camera", "lens.json"]) == code
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    assert message in said
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.mp4", "lens.json"]
