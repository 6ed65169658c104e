"""Laws of rectify and calibrate over kinds of pictures, lenses and misuse."""

import dataclasses
import math
from functools import cache

import cv2
import numpy as np
import pytest

from classical.camera import KannalaBrandt, Pinhole
from hybrid import (
    Rectification,
    RectificationError,
    Rectifier,
    RectifyConfig,
    calibrate,
    draw_curves,
    rectify,
)
from hybrid.figure import side_by_side
from hybrid.methods import DEFAULT_METHOD, METHODS, make_estimator, method_names

WIDTH, HEIGHT = 480, 360
LENS = KannalaBrandt.centred(np.array([0.95, -0.06, 0.004, 0.0, 0.0]), WIDTH, HEIGHT)


def room(camera: KannalaBrandt | Pinhole, turn: float = 0.35) -> np.ndarray:
    """The inside of a box whose walls carry plain panels, as the camera sees it; (h, w, 3) uint8.

    Rendered at four rays a pixel; edges of panels are straight lines in the world.
    """
    offsets = (-0.25, 0.25)
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    total = np.zeros((camera.height, camera.width, 3))
    for du in offsets:
        for dv in offsets:
            points = np.stack([u.ravel() + du, v.ravel() + dv], axis=1)
            rays, valid = camera.unproject(points)
            colours = np.where(valid[:, None], _seen(rays, turn), 0.0)
            total += colours.reshape(total.shape) / 4
    noisy = total + np.random.default_rng(0).normal(0, 1.0, total.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def _seen(rays: np.ndarray, turn: float) -> np.ndarray:
    """Colours along rays from inside a box of 5 x 3 x 6 metres."""
    c, s = math.cos(turn), math.sin(turn)
    rays = rays @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T
    half = np.array([2.5, 1.5, 3.0])
    reach = half / np.maximum(np.abs(rays), 1e-9)
    axis = reach.argmin(axis=1)
    hit = rays * reach.min(axis=1)[:, None]
    side = 2 * axis + (np.take_along_axis(rays, axis[:, None], axis=1)[:, 0] > 0)
    across = np.where(axis == 0, hit[:, 2], hit[:, 0])
    along = np.where(axis == 1, hit[:, 2], hit[:, 1])
    cell = np.floor(across / 0.8).astype(int) * 7 + np.floor(along / 0.6).astype(int) * 3
    inset = (np.abs(across / 0.8 % 1 - 0.5) < 0.36) & (np.abs(along / 0.6 % 1 - 0.5) < 0.36)
    panel = 70 + 37 * ((cell + side) % 5)
    base = 60 + 25 * side
    shade = np.where(inset, panel, base).astype(float)
    return shade[:, None] * np.array([1.0, 0.95, 0.85])


@cache
def fisheye_room() -> np.ndarray:
    return room(LENS)


@cache
def rectified_room() -> Rectification:
    return rectify(fisheye_room(), RectifyConfig(method="classical"))


def aligned_error(camera: KannalaBrandt) -> float:
    """RMS error in pixels of a 320 pixel frame after the best similarity, angles up to 55°."""
    u, v = np.meshgrid(np.arange(0, WIDTH, 8.0), np.arange(0, HEIGHT, 8.0))
    points = np.stack([u.ravel(), v.ravel()], axis=1)
    true, _ = LENS.unproject(points)
    found, _ = camera.unproject(points)
    near = true[:, 2] > math.cos(math.radians(55))
    frame = Pinhole.centred(160.0, 320, 320)
    a, b = (frame.project(rays[near])[0] - 159.5 for rays in (true, found))
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    return float(np.sqrt(((a - (S.sum() / (b**2).sum()) * b @ (U @ Vt)) ** 2).sum(axis=1).mean()))


# ---- what comes out ---------------------------------------------------------------------------


def test_a_room_becomes_straight():
    result = rectified_room()
    assert result.status in ("ok", "degraded")
    assert result.camera is not None
    assert aligned_error(result.camera) < 2.0
    assert result.quality.rms_px < 0.5
    assert result.quality.n_inliers >= 10


def test_the_result_names_its_target_and_real_pixels():
    result = rectified_room()
    assert result.target is not None
    assert result.valid.shape == result.image.shape[:2] == (HEIGHT, WIDTH)
    assert result.valid.all()
    assert (result.target.width, result.target.height) == (WIDTH, HEIGHT)


def test_the_same_picture_gives_the_same_answer():
    again = Rectifier(RectifyConfig(method="classical")).rectify(fisheye_room())
    first = rectified_room()
    assert again.camera == first.camera
    np.testing.assert_array_equal(again.image, first.image)


def as_kind(image: np.ndarray, dtype: str, shape: str) -> np.ndarray:
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    shaped = {
        "grey": grey,
        "grey1": grey[..., None],
        "rgb": image,
        "rgba": np.dstack([image, np.full_like(grey, 255)]),
    }[shape]
    if dtype == "uint16":
        return shaped.astype(np.uint16) * 257
    return shaped if dtype == "uint8" else (shaped / 255).astype(dtype)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32", "float64"])
@pytest.mark.parametrize("shape", ["grey", "grey1", "rgb", "rgba"])
def test_dtype_and_channels_are_those_of_the_input(dtype, shape):
    image = as_kind(fisheye_room(), dtype, shape)
    result = rectify(image, camera=LENS)
    assert result.image.dtype == image.dtype
    assert result.image.shape == image.shape
    scale = {"uint8": 1.0, "uint16": 257.0}.get(dtype, 1 / 255)
    plain = rectify(as_kind(fisheye_room(), "uint8", shape), camera=LENS).image
    # two resolutions of 8 bits are mixed, each rounded
    np.testing.assert_allclose(result.image / scale, plain, atol=2.0)


@pytest.mark.parametrize(("dtype", "shape"), [("uint16", "grey"), ("float32", "rgba")])
def test_other_kinds_of_pictures_are_estimated_too(dtype, shape):
    result = rectify(as_kind(fisheye_room(), dtype, shape), RectifyConfig(method="classical"))
    assert result.camera is not None
    assert aligned_error(result.camera) < 2.5


def test_a_straight_picture_comes_back_unchanged_in_effect():
    straight = room(Pinhole.centred(260.0, WIDTH, HEIGHT))
    result = rectify(straight, RectifyConfig(method="classical"), throw=False)
    if result.camera is None:
        np.testing.assert_array_equal(result.image, straight)
        return
    target = result.target
    assert target is not None
    corners = np.array([[u, v] for u in (0.0, WIDTH - 1) for v in (0.0, HEIGHT - 1)])
    moved = target.project(result.camera.unproject(corners)[0])[0]
    assert np.abs(moved - corners).max() < 0.02 * WIDTH


def test_identity_leaves_the_picture_alone():
    image = fisheye_room()
    result = rectify(image, RectifyConfig(method="identity"))
    np.testing.assert_array_equal(result.image, image)
    assert result.status == "ok"
    assert result.camera is None
    assert result.target is None
    assert result.valid.all()


@pytest.mark.parametrize(
    "options",
    [{"focal": 160.0, "size": (320, 320)}, {"fov": 90.0}, {"balance": 1.0}, {"size": (300, 500)}],
)
def test_the_frame_is_the_one_asked_for(options):
    result = rectify(fisheye_room(), RectifyConfig(**options), camera=LENS)
    width, height = options.get("size", (WIDTH, HEIGHT))
    assert result.image.shape == (height, width, 3)
    assert result.target is not None
    if "focal" in options:
        assert result.target.focal_u == options["focal"]
    if "fov" in options:
        assert math.degrees(result.target.horizontal_fov) == pytest.approx(options["fov"])
    if "balance" in options:
        assert not result.valid.all()
        assert not result.image[~result.valid].any()


def test_a_camera_serves_the_picture_at_other_resolutions():
    large = cv2.resize(fisheye_room(), (2 * WIDTH, 2 * HEIGHT))
    result = rectify(large, camera=LENS)
    assert result.camera is not None
    assert (result.camera.width, result.camera.height) == (2 * WIDTH, 2 * HEIGHT)
    small = cv2.resize(result.image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    reference = rectify(fisheye_room(), camera=LENS).image
    assert np.abs(small.astype(int) - reference).mean() < 4


def test_a_camera_of_another_shape_is_refused():
    with pytest.raises(ValueError, match="shaped like"):
        rectify(np.zeros((300, 480, 3), np.uint8), camera=LENS)


def test_many_pictures_are_one_lens():
    pictures = [room(LENS, turn) for turn in (0.1, 0.5)]
    found = calibrate(pictures, RectifyConfig(method="classical"))
    assert found.camera is not None
    assert len(found.curves) == 2
    assert aligned_error(found.camera) < 1.5


# ---- what has no answer -----------------------------------------------------------------------

HOPELESS = {
    "black": np.zeros((HEIGHT, WIDTH, 3), np.uint8),
    "white": np.full((HEIGHT, WIDTH), 65535, np.uint16),
    "noise": np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8),
    "1x1": np.zeros((1, 1, 3), np.uint8),
    "one row": np.zeros((1, 500), np.float32),
    "tiny": np.zeros((20, 20, 4), np.uint8),
}


@pytest.mark.parametrize("name", HOPELESS)
def test_no_answer_is_a_result_with_a_reason(name):
    image = HOPELESS[name]
    result = rectify(image, RectifyConfig(method="classical"), throw=False)
    assert result.status == "failed"
    assert result.reason
    assert result.camera is None
    np.testing.assert_array_equal(result.image, image)


def test_no_answer_raises_its_reason_if_asked():
    quiet = rectify(HOPELESS["black"], RectifyConfig(method="classical"), throw=False)
    with pytest.raises(RectificationError) as caught:
        rectify(HOPELESS["black"], RectifyConfig(method="classical"))
    assert str(caught.value) == quiet.reason


def test_calibrating_black_pictures_fails_with_a_reason():
    found = calibrate([HOPELESS["black"]] * 2, RectifyConfig(method="classical"))
    assert found.status == "failed"
    assert found.camera is None
    assert found.reason


def test_a_lens_that_no_pinhole_shows_fails_with_a_reason():
    rim = KannalaBrandt(np.array([0.6, 0, 0, 0, 0]), 100.0, 100.0, -300.0, 50.0, 100, 100)
    image = np.zeros((100, 100, 3), np.uint8)
    result = rectify(image, camera=rim, throw=False)
    assert result.status == "failed"
    assert "optical axis" in result.reason


# ---- misuse -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((0, 0, 3), np.uint8), "with pixels"),
        (np.full((40, 40), np.nan), "NaN"),
        (np.zeros((40, 40, 2), np.uint8), "shape"),
        (np.zeros((40, 40), np.int32), "type"),
    ],
)
@pytest.mark.parametrize("method", ["identity", "classical"])
def test_malformed_pictures_are_refused(image, message, method):
    with pytest.raises(ValueError, match=message):
        rectify(image, RectifyConfig(method=method), throw=False)
    with pytest.raises(ValueError, match=message):
        calibrate([image], RectifyConfig(method=method))


def test_calibrate_refuses_nothing_and_mixed_sizes():
    with pytest.raises(ValueError, match="at least one"):
        calibrate([])
    with pytest.raises(ValueError, match="one size"):
        calibrate([np.zeros((40, 50), np.uint8), np.zeros((50, 40), np.uint8)])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "magic"}, "classical, learned, .*identity"),
        ({"fov": 90.0, "balance": 0.5}, "fov and balance"),
        ({"fov": 180.0}, "fov"),
        ({"focal": 0.0}, "focal"),
        ({"balance": -0.1}, "balance"),
        ({"size": (0, 5)}, "size"),
        ({"interpolation": "magic"}, "interpolation"),
        ({"threads": 0}, "threads"),
    ],
)
def test_config_refuses_misuse(options, message):
    with pytest.raises(ValueError, match=message):
        RectifyConfig(**options)


def test_config_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        RectifyConfig().fov = 5.0  # type: ignore[misc]


def test_every_method_of_the_table_is_there():
    assert method_names()[0] == DEFAULT_METHOD
    for method in METHODS:
        assert callable(make_estimator(RectifyConfig(method=method.name)))


def test_threads_are_given_back():
    before = cv2.getNumThreads()
    rectify(fisheye_room(), RectifyConfig(threads=1), camera=LENS)
    assert cv2.getNumThreads() == before


# ---- drawing ----------------------------------------------------------------------------------


def test_overlay_draws_on_the_curves_only():
    result = rectified_room()
    image = fisheye_room()
    drawn = draw_curves(image, result.curves, legend=False)
    changed = (drawn != image).any(axis=2)
    near = np.zeros((HEIGHT, WIDTH), np.uint8)
    for curve in result.curves:
        cv2.polylines(near, [np.rint(curve.points).astype(np.int32)], False, 255, 9)
    assert changed.mean() > 0.005
    assert not (changed & (near == 0)).any()


def test_residuals_change_the_colour():
    curve = rectified_room().curves[0]
    blank = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
    low, high = (
        draw_curves(
            blank,
            [dataclasses.replace(curve, residual_px=residual, inlier=True)],
            max_residual=1.0,
            legend=False,
        )
        for residual in (0.0, 1.0)
    )
    assert (low != high).any()


@pytest.mark.parametrize("shape", ["grey", "rgba"])
def test_figure_of_any_picture(shape):
    image = as_kind(fisheye_room(), "uint8", shape)
    for config in (RectifyConfig(method="identity"), RectifyConfig(method="classical")):
        figure = side_by_side(image, rectify(image, config), height=200)
        assert figure.dtype == np.uint8
        assert figure.shape[0] > 200
        assert figure.shape[2] == 3


def test_seed_reaches_the_random_frames_of_the_fit(monkeypatch):
    from hybrid import estimators

    seeds = []

    def fit(*_arguments, config, **_known):
        seeds.extend([config.parallels.seed, config.vanishing.seed])
        raise RuntimeError("seen")

    monkeypatch.setattr(estimators, "fit_lens", fit)
    with pytest.raises(RuntimeError, match="seen"):
        estimators.ClassicalEstimator(RectifyConfig(seed=7))([np.zeros((64, 64, 3), np.uint8)])
    assert seeds == [7, 7]
