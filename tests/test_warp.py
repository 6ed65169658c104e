"""Laws of the warp: target cameras, maps both ways, resampling, ST-map files."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from classical.camera import Division, KannalaBrandt, Pinhole
from classical.files import atomic_path
from classical.warp import (
    WarpMaps,
    distort_maps,
    pinhole_target,
    read_stmap,
    remap,
    undistort_maps,
    write_stmap,
)

WIDTH, HEIGHT = 160, 120
DTYPES = ("uint8", "uint16", "float16", "float32", "float64")


def equidistant(fov: float, width: int = WIDTH, height: int = HEIGHT) -> KannalaBrandt:
    """r = θ / (fov / 2) in half widths: `fov` degrees from the left to the right edge."""
    k = np.array([1 / math.radians(fov / 2), 0.0, 0.0, 0.0, 0.0])
    return KannalaBrandt.centred(k, width, height)


def tangent(half_fov: float, width: int = WIDTH, height: int = HEIGHT) -> KannalaBrandt:
    """Nearly a pinhole: the series of tan θ to θ⁹."""
    k = np.array([1, 1 / 3, 2 / 15, 17 / 315, 62 / 2835]) / math.tan(math.radians(half_fov))
    return KannalaBrandt.centred(k, width, height)


def smooth_picture(width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    u, v = np.meshgrid(np.linspace(0, 6, width), np.linspace(0, 5, height))
    return (0.5 + 0.2 * np.sin(u) + 0.2 * np.cos(v)).astype(np.float32)


def identity_maps(width: int, height: int, factor: float = 1.0) -> WarpMaps:
    """A map that shrinks by `factor`, the outer edges in place."""
    shape = (round(height / factor), round(width / factor))
    u, v = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    u, v = ((axis + 0.5) * factor - 0.5 for axis in (u, v))
    return WarpMaps(u.astype(np.float32), v.astype(np.float32), np.ones(shape, bool), width, height)


# ---- target cameras ---------------------------------------------------------------------------


def test_focal_and_size_give_the_paper_frame():
    target = pinhole_target(equidistant(120), focal=160.0, size=(320, 320))
    assert target == Pinhole(160.0, 160.0, 159.5, 159.5, 320, 320)


@pytest.mark.parametrize("fov", [10.0, 90.0, 150.0])
def test_fov_is_the_horizontal_field_of_view(fov):
    target = pinhole_target(equidistant(120), fov=fov, size=(400, 200))
    assert math.degrees(target.horizontal_fov) == pytest.approx(fov)


CAMERAS = {
    **{f"equidistant {fov}": equidistant(fov) for fov in (15, 60, 100, 140, 180, 220, 300)},
    "off centre": KannalaBrandt(np.array([0.9, -0.03, 0, 0, 0]), 80.0, 84.0, 95.0, 52.0, 160, 120),
    "turns back at 72°": KannalaBrandt.centred(np.array([1.2, -0.25, 0, 0, 0]), 160, 120),
    "portrait": equidistant(110, 90, 200),
    "division": Division(-1.5e-5, 85.0, 55.0, 160, 120),
    "pincushion": Division(2e-5, 80.0, 60.0, 160, 120),
    "one corner of a lens": equidistant(170, 400, 400).cropped(250, 240, 140, 150),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_balance_zero_has_no_empty_pixel(name):
    camera = CAMERAS[name]
    assert undistort_maps(camera, pinhole_target(camera, balance=0.0)).valid.all()


@pytest.mark.parametrize("name", CAMERAS)
def test_balance_one_loses_no_pixel_within_75_degrees(name):
    camera = CAMERAS[name]
    target = pinhole_target(camera, balance=1.0)
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    rays, valid = camera.unproject(np.stack([u.ravel(), v.ravel()], axis=1))
    points, ahead = target.project(rays[valid & (rays[:, 2] > math.cos(math.radians(74.9)))])
    assert ahead.all()
    assert points.min() >= -0.51
    assert (points.max(axis=0) <= np.array([target.width, target.height]) - 0.49).all()


@pytest.mark.parametrize("name", CAMERAS)
def test_field_of_view_grows_with_balance(name):
    balances = np.linspace(0, 1, 6)
    focals = [pinhole_target(CAMERAS[name], balance=b).focal_u for b in balances]
    assert (np.diff(focals) <= 1e-9).all()


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(-0.4, 0.4), min_size=4, max_size=4),
    st.floats(0.3, 2.0),
    st.floats(-0.3, 0.3),
    st.floats(-0.3, 0.3),
    st.floats(0, 1),
)
def test_target_is_sane_for_any_lens(tail, k1, shift_u, shift_v, balance):
    tail = np.round(tail, 6)
    camera = KannalaBrandt(
        np.array([k1, *tail]), 80.0, 80.0, 79.5 + 80 * shift_u, 59.5 + 60 * shift_v, 160, 120
    )
    target = pinhole_target(camera, balance=balance)
    assert 1 < target.focal_u < 1e5
    assert 0 < math.degrees(target.horizontal_fov) < 165


def test_largest_full_frame_of_a_known_lens():
    # r = θ: the middle of the top edge at θ = 45° bounds a wide frame, tan 45° = 1
    camera = equidistant(180, 1000, 500)
    target = pinhole_target(camera, size=(500, 500))
    assert target.focal_u == pytest.approx(250, rel=2e-3)


def test_straight_picture_keeps_its_frame():
    camera = tangent(20)
    target = pinhole_target(camera)
    maps = undistort_maps(camera, target)
    image = smooth_picture()
    np.testing.assert_allclose(remap(image, maps), image, atol=0.01)


def test_size_scales_the_frame():
    small = pinhole_target(equidistant(120))
    large = pinhole_target(equidistant(120), size=(2 * WIDTH, 2 * HEIGHT))
    assert large.focal_u == pytest.approx(2 * small.focal_u)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"focal": 100.0, "fov": 90.0}, "at most one"),
        ({"fov": 180.0}, "field of view"),
        ({"fov": 0.0}, "field of view"),
        ({"balance": 1.5}, "balance"),
        ({"focal": -3.0}, "positive focal"),
        ({"size": (0, 10)}, "at least 1x1"),
    ],
)
def test_target_refuses_misuse(options, message):
    with pytest.raises(ValueError, match=message):
        pinhole_target(equidistant(120), **options)


@pytest.mark.parametrize("size", [(160, 120), (4000, 3000)], ids=str)
@pytest.mark.parametrize("beyond", [-60, -3, 0, 4])  # pixels that the axis is off to the right
def test_a_lens_of_few_pixels_is_shown_without_an_empty_one(size, beyond):
    # turns back at 26°, 8 pixels off its axis
    k = np.array([0.305, -0.375, -0.375, 0, 0]) * 160 / size[0]
    u0 = size[0] - 0.5 + beyond
    camera = KannalaBrandt(k, size[0] / 2, size[0] / 2, u0, 0.3 * size[1], *size)
    target = pinhole_target(camera, size=(160, 120))
    assert undistort_maps(camera, target).valid.all()
    assert math.degrees(target.horizontal_fov) > (30 if beyond < 0 else 5)


def test_target_refuses_a_picture_of_the_rim_only():
    rim = equidistant(220, 1000, 1000).cropped(930, 400, 60, 200)
    with pytest.raises(ValueError, match="within 65° of the optical axis"):
        pinhole_target(rim)


# ---- maps -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["equidistant 140", "off centre", "turns back at 72°"])
@pytest.mark.parametrize("balance", [0.0, 1.0])
def test_fast_maps_equal_projection_of_rays(name, balance):
    camera = CAMERAS[name]
    target = pinhole_target(camera, balance=balance)
    maps = undistort_maps(camera, target)
    u, v = np.meshgrid(np.arange(target.width, dtype=float), np.arange(target.height, dtype=float))
    rays, _ = target.unproject(np.stack([u.ravel(), v.ravel()], axis=1))
    points, seen = camera.project(rays)
    last = np.array([camera.width, camera.height]) - 1.0
    valid = seen & (points >= -0.5).all(axis=1) & (points <= last + 0.5).all(axis=1)
    assert (valid == maps.valid.ravel()).mean() > 0.9999
    both = valid & maps.valid.ravel()
    expected = np.clip(points, 0, last)[both]
    found = np.stack([maps.u.ravel(), maps.v.ravel()], axis=1)[both]
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_maps_are_computed_once():
    camera = equidistant(100)
    target = pinhole_target(camera)
    assert undistort_maps(camera, target) is undistort_maps(equidistant(100), target)


def test_maps_are_float32_and_locked():
    maps = distort_maps(equidistant(100), pinhole_target(equidistant(100)))
    assert maps.u.dtype == maps.v.dtype == np.float32
    with pytest.raises(ValueError, match="read-only"):
        maps.u[0, 0] = 0


def test_distorting_undoes_undistorting():
    camera, image = equidistant(120, 320, 240), smooth_picture(320, 240)
    target = pinhole_target(camera, balance=1.0, size=(960, 720))
    straight = remap(image, undistort_maps(camera, target))
    back = distort_maps(camera, target)
    inner = cv2.erode(back.valid.astype(np.uint8), np.ones((9, 9))) > 0
    inner[:4], inner[-4:], inner[:, :4], inner[:, -4:] = False, False, False, False
    assert inner.mean() > 0.5
    assert np.abs(remap(straight, back) - image)[inner].max() < 0.01


def test_pixels_past_the_lens_are_not_valid():
    camera = CAMERAS["turns back at 72°"]
    target = pinhole_target(camera, fov=160.0)
    maps = undistort_maps(camera, target)
    assert not maps.valid[HEIGHT // 2, 0]
    assert maps.valid[HEIGHT // 2, WIDTH // 2]
    assert not remap(np.ones((HEIGHT, WIDTH), np.uint8), maps)[~maps.valid].any()


@pytest.mark.parametrize("factor", [1.0, 2.0, 3.5])
def test_scale_of_a_uniform_map(factor):
    scale = identity_maps(140, 70, factor).scale
    np.testing.assert_allclose(scale, factor, rtol=1e-3)


def test_too_large_side_is_refused():
    camera = equidistant(90, 40000, 4)
    with pytest.raises(ValueError, match="32766"):
        undistort_maps(camera, Pinhole.centred(10.0, 4, 4))


# ---- resampling -------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("channels", [(), (1,), (3,), (4,), (6,)])
def test_dtype_and_channels_are_kept(dtype, channels):
    camera = equidistant(120)
    maps = undistort_maps(camera, pinhole_target(camera, size=(50, 40)))
    out = remap(np.ones((HEIGHT, WIDTH, *channels), dtype), maps)
    assert out.dtype == dtype
    assert out.shape == (40, 50, *channels)
    np.testing.assert_allclose(out, 1, rtol=1e-3)


def test_channels_do_not_mix():
    camera = equidistant(120)
    maps = undistort_maps(camera, pinhole_target(camera, balance=0.5))
    image = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 6), dtype=np.uint8)
    stacked = remap(image, maps)
    for channel in range(6):
        single = remap(np.ascontiguousarray(image[..., channel]), maps)
        np.testing.assert_allclose(stacked[..., channel].astype(int), single, atol=1)


@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_without_antialias_it_is_cv2_remap(dtype):
    camera = equidistant(120)
    maps = undistort_maps(camera, pinhole_target(camera, balance=1.0))
    image = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(dtype)
    bare = cv2.remap(image, maps.u, maps.v, cv2.INTER_LINEAR)
    np.testing.assert_array_equal(remap(image, maps, antialias=False), bare)


@pytest.mark.parametrize("factor", [1.5, 2.1, 3.3, 6.3])
def test_antialias_keeps_fine_stripes_grey(factor):
    stripes = np.zeros((240, 240), np.float32)
    stripes[:, ::2] = 1
    maps = identity_maps(240, 240, factor)
    margin = slice(4, -4)
    aliased = remap(stripes, maps, antialias=False)[margin, margin]
    clean = remap(stripes, maps)[margin, margin]
    assert clean.mean() == pytest.approx(0.5, abs=0.02)
    assert clean.std() < 0.12
    assert clean.std() < 0.5 * aliased.std()


def test_antialias_leaves_enlarged_parts_alone():
    camera = equidistant(140, 320, 240)
    maps = undistort_maps(camera, pinhole_target(camera, balance=0.3))
    image = np.random.default_rng(0).random((240, 320), dtype=np.float32)
    changed = remap(image, maps) != remap(image, maps, antialias=False)
    assert changed[maps.scale > 1.35].mean() > 0.99
    assert not changed[maps.scale < 0.8].any()


@pytest.mark.parametrize("factor", [1.0, 1.4, 2.0, 3.7, 5.0])
@pytest.mark.parametrize("size", [(64, 48), (97, 131), (700, 301)], ids=str)
def test_antialias_keeps_things_in_place(factor, size):
    """A ramp stays the ramp that it is, on every level and at odd sizes."""
    width, height = size
    ramp = np.add.outer(np.arange(height), 3.0 * np.arange(width)).astype(np.float32)
    maps = identity_maps(width, height, factor)
    inner = slice(4, -4) if factor < 3 else slice(2, -2)
    expected = maps.v + 3.0 * maps.u
    error = np.abs(remap(ramp, maps) - expected)[inner, inner]
    assert error.max(initial=0.0) < 0.01


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_grain_shrinks_without_a_seam(dtype):
    """White noise loses its deviation as 1 / scale, in steps of at most 2."""
    camera = equidistant(120, 640, 480)
    maps = undistort_maps(camera, pinhole_target(camera, balance=1.0))
    rng = np.random.default_rng(0)
    noise = np.clip(rng.normal(0.5, 0.12, (480, 640)), 0, 1)
    most = 1.0 if dtype == "float32" else np.iinfo(dtype).max
    out = remap((noise * most).astype(dtype), maps).astype(np.float64) / most
    for low, high in ((1.5, 1.9), (1.9, 2.3), (2.3, 2.7)):
        ring = (maps.scale > low) & (maps.scale < high)
        deviation = out[ring].std() / (0.12 * 2 / 3)  # 2/3: what a bilinear lookup leaves
        assert 0.6 < deviation * (low + high) / 2 < 1.4


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("interpolation", ["linear", "lanczos"])
def test_no_pixel_is_looked_up_where_nothing_was_drawn(name, interpolation):
    """The sheet's memory holds another picture; none of it may show."""
    camera = CAMERAS[name]
    shape = (camera.height, camera.width)
    for size in ((40, 30), (camera.width, camera.height)):
        maps = undistort_maps(camera, pinhole_target(camera, balance=1.0, size=size))
        bright = identity_maps(4 * camera.width, 4 * camera.height, 2.5)
        remap(np.full((4 * camera.height, 4 * camera.width), 9e3, np.float32), bright)
        out = remap(np.full(shape, 0.5, np.float32), maps, interpolation=interpolation)
        np.testing.assert_allclose(out, np.where(maps.valid, 0.5, 0), atol=1e-3)


@pytest.mark.parametrize("interpolation", ["nearest", "linear", "cubic", "lanczos"])
def test_a_plain_picture_stays_plain_up_to_its_rim(interpolation):
    camera = equidistant(120)
    maps = undistort_maps(camera, pinhole_target(camera, balance=1.0))
    out = remap(np.full((HEIGHT, WIDTH), 0.5), maps, interpolation=interpolation)
    np.testing.assert_allclose(out, np.where(maps.valid, 0.5, 0), atol=1e-3)


def test_nearest_keeps_labels():
    camera = equidistant(120)
    maps = undistort_maps(camera, pinhole_target(camera, balance=1.0))
    labels = np.random.default_rng(0).choice(np.array([3, 200], np.uint8), (HEIGHT, WIDTH))
    assert set(np.unique(remap(labels, maps, interpolation="nearest"))) <= {0, 3, 200}


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((HEIGHT, WIDTH), np.int32), "type"),
        (np.zeros((HEIGHT, WIDTH + 1), np.uint8), "source size"),
        (np.zeros(WIDTH, np.uint8), "dimensions"),
    ],
)
def test_remap_refuses_misuse(image, message):
    maps = undistort_maps(equidistant(120), pinhole_target(equidistant(120)))
    with pytest.raises(ValueError, match=message):
        remap(image, maps)


# ---- files ------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".tif", ".TIFF", ".exr"])
@pytest.mark.parametrize("make", [undistort_maps, distort_maps])
def test_stmap_is_read_back(tmp_path, suffix, make):
    if suffix == ".exr":
        pytest.importorskip("OpenEXR")
    camera = CAMERAS["off centre"]
    maps = make(camera, pinhole_target(camera, balance=1.0))
    write_stmap(tmp_path / f"map{suffix}", maps)
    read = read_stmap(tmp_path / f"map{suffix}", maps.source_width, maps.source_height)
    np.testing.assert_array_equal(read.valid, maps.valid)
    np.testing.assert_allclose(read.u, maps.u, atol=1e-4)
    np.testing.assert_allclose(read.v, maps.v, atol=1e-4)


def test_stmap_origin_is_the_bottom_left_corner(tmp_path):
    import tifffile

    write_stmap(tmp_path / "map.tif", identity_maps(10, 5))
    pixels = tifffile.imread(tmp_path / "map.tif")
    assert pixels.dtype == np.float32
    np.testing.assert_allclose(pixels[-1, 0], [0.05, 0.1, 1], atol=1e-6)
    np.testing.assert_allclose(pixels[0, -1], [0.95, 0.9, 1], atol=1e-6)


def test_stmap_refuses_other_files(tmp_path):
    with pytest.raises(ValueError, match="ending in"):
        write_stmap(tmp_path / "map.png", identity_maps(4, 4))
    (tmp_path / "map.tif").write_text("no picture")
    with pytest.raises(ValueError, match="32-bit"):
        read_stmap(tmp_path / "map.tif", 4, 4)
    (tmp_path / "map.exr").write_text("no picture")
    pytest.importorskip("OpenEXR")
    with pytest.raises(ValueError, match="32-bit"):
        read_stmap(tmp_path / "map.exr", 4, 4)


def _write_half(path):
    with atomic_path(path) as temporary:
        temporary.write_text("half of the n")
        raise RuntimeError


def test_failed_writing_leaves_the_old_file(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError):
        _write_half(path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_atomic_writing_replaces_the_file(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("old")
    with atomic_path(path) as temporary:
        temporary.write_text("new")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]
