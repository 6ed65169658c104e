from pathlib import Path

import numpy as np
import pytest
import torch
from numpy import ndarray
from small_networks import SMALL

from classical.camera import Division, KannalaBrandt
from learned.dlp import LinePerception
from learned.export import export_onnx
from learned.larecnet import LaRecNet
from learned.letterbox import Letterbox, as_tensor
from learned.predictor import Predictor, RongPredictor
from learned.rong import RongCfg, RongNet
from learned.weights import load_weights, save_weights

SHAPES = [(320, 320), (240, 320), (500, 333), (97, 640)]
VECTOR = np.array([1.2, -0.06, 0.01, 0.0, 0.0, 1.0, 1.01, 0.03, -0.05])


@pytest.fixture(scope="module")
def network() -> LaRecNet:
    torch.manual_seed(0)
    return LaRecNet(SMALL).eval()


def _picture(height: int, width: int) -> ndarray:
    return np.random.default_rng(0).integers(0, 255, (height, width, 3), dtype=np.uint8)


def _frame(size: int = 320) -> KannalaBrandt:
    half, middle = size / 2, (size - 1) / 2
    scaled = np.concatenate([VECTOR[:5], VECTOR[5:7] * half, VECTOR[7:] * half + middle])
    return KannalaBrandt.from_vector(scaled, size, size)


@pytest.mark.parametrize(("height", "width"), SHAPES)
def test_letterbox_camera_sees_the_same_rays(height: int, width: int) -> None:
    box = Letterbox(width, height, 320)
    rng = np.random.default_rng(0)
    points = rng.uniform([0, 0], [width - 1, height - 1], (50, 2))
    inner, corner = np.array(box.inner), np.array(box.corner)
    in_frame = (points + 0.5) * (inner / [width, height]) - 0.5 + corner
    rays, valid = box.camera(VECTOR).unproject(points)
    expected, also = _frame().unproject(in_frame)
    assert (valid == also).all()
    np.testing.assert_allclose(rays[valid], expected[valid], atol=1e-6)


@pytest.mark.parametrize(("height", "width"), SHAPES)
def test_letterbox_covariance_is_the_jacobians(height: int, width: int) -> None:
    box = Letterbox(width, height, 320)
    rng = np.random.default_rng(1)
    root = rng.normal(size=(9, 9)) * 1e-3
    root[5] = 0.0  # the gauge
    covariance = root @ root.T
    step = 1e-6
    jacobian = np.zeros((9, 9))
    for i in (0, 1, 2, 3, 4, 6, 7, 8):
        moved = [VECTOR.copy(), VECTOR.copy()]
        moved[0][i] += step
        moved[1][i] -= step
        high, low = (box.camera(v).to_vector() for v in moved)
        jacobian[:, i] = (high - low) / (2 * step)
    np.testing.assert_allclose(
        box.covariance(covariance), jacobian @ covariance @ jacobian.T, rtol=1e-5, atol=1e-12
    )


def test_letterbox_keeps_the_picture_and_pads_black() -> None:
    image = np.full((100, 200, 3), 255, np.uint8)
    frame = Letterbox(200, 100, 64).fill(as_tensor(image))[0, 0]
    assert frame.shape == (64, 64)
    torch.testing.assert_close(frame[16:48], torch.ones(32, 64))
    assert frame[:16].sum() == 0
    assert frame[48:].sum() == 0


@pytest.mark.parametrize(
    "image",
    [
        np.full((4, 5), 51, np.uint8),
        np.full((4, 5, 1), 51, np.uint8),
        np.full((4, 5, 4), 51, np.uint8),
        np.full((4, 5, 3), 13107, np.uint16),
        np.full((4, 5, 3), 0.2, np.float32),
    ],
)
def test_every_kind_of_picture_becomes_rgb_in_zero_to_one(image: ndarray) -> None:
    torch.testing.assert_close(as_tensor(image), torch.full((1, 3, 4, 5), 0.2))


def test_what_is_no_picture_is_refused() -> None:
    with pytest.raises(ValueError, match="expected a picture"):
        as_tensor(np.zeros((4, 5, 2), np.uint8))


@pytest.mark.parametrize(("height", "width"), SHAPES)
def test_prediction_fits_the_picture(network: LaRecNet, height: int, width: int) -> None:
    predictor = Predictor(network)
    found = predictor.lens(_picture(height, width))
    assert found.camera is not None
    assert (found.camera.width, found.camera.height) == (width, height)
    assert found.camera.m_u == pytest.approx(width / 2)
    assert found.covariance is not None
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-9
    assert (np.diag(found.covariance) > 0).sum() == 8
    lines = predictor.lines(_picture(height, width), longest=200)
    scale = min(1.0, 200 / max(height, width))
    assert lines.heatmap.shape == (round(height * scale), round(width * scale))


@pytest.fixture(scope="module")
def unsure() -> Predictor:
    """With a head whose uncertainty is not the same everywhere, as it is before training."""
    torch.manual_seed(1)
    network = LaRecNet(SMALL)
    torch.nn.init.normal_(network.uncertainty.last.weight, std=0.5)
    return Predictor(network)


@pytest.mark.parametrize(("height", "width"), SHAPES)
def test_uncertainty_has_geometric_mean_one_over_the_networks_frame(
    unsure: Predictor, height: int, width: int
) -> None:
    side = SMALL.frame // SMALL.pixel_stride
    found = unsure.uncertainty(_picture(height, width))
    assert found.shape == (side, side)
    assert np.log(found).mean() == pytest.approx(0.0, abs=1e-4)
    assert found.std() > 0.1


def test_same_picture_gives_the_same_answer(network: LaRecNet) -> None:
    predictor = Predictor(network)
    first, second = (predictor.lens(_picture(120, 160)) for _ in range(2))
    assert first.camera == second.camera


def test_tiles_agree_with_one_pass_away_from_their_edges(network: LaRecNet) -> None:
    image = _picture(96, 900)
    tiled = Predictor(network).lines(image, longest=900).lineness
    with torch.inference_mode():
        padded = torch.nn.functional.pad(as_tensor(image), (0, 12, 0, 0))
        whole = network.dlp.lineness(network.dlp(padded).raw)[0, 0, :96, :900].numpy()
    assert np.abs(tiled - whole)[:, 120:360].max() < 1e-4


def test_weights_come_back_in_half_precision(network: LaRecNet, tmp_path: Path) -> None:
    path = tmp_path / "tiny.safetensors"
    save_weights(path, network, {"seed": 1, "scores": {"rpe": 1.5}})
    loaded = load_weights(path, LaRecNet)
    assert loaded.card["scores"]["rpe"] == 1.5
    assert "rpe: 1.5" in path.with_suffix(".md").read_text()
    after = loaded.network.state_dict()
    for name, value in network.state_dict().items():
        torch.testing.assert_close(after[name], value, atol=1e-3, rtol=1e-3)
    assert loaded.network.cfg == network.cfg


def test_altered_weights_are_refused(network: LaRecNet, tmp_path: Path) -> None:
    path = tmp_path / "tiny.safetensors"
    save_weights(path, network, {})
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(ValueError, match="expected checksum"):
        load_weights(path, LaRecNet)


def test_weights_of_another_network_are_refused(network: LaRecNet, tmp_path: Path) -> None:
    path = tmp_path / "dlp.safetensors"
    save_weights(path, network.dlp, {})
    assert isinstance(load_weights(path, LinePerception).network, LinePerception)
    with pytest.raises(ValueError, match="larecnet"):
        load_weights(path, LaRecNet)
    path.with_suffix(".sha256").unlink()
    path.write_bytes(b"not weights")
    with pytest.raises(ValueError, match="safetensors"):
        load_weights(path, LaRecNet)


def test_rong_gives_a_centred_division_model_of_the_picture() -> None:
    predictor = RongPredictor(RongNet(RongCfg(widths=(8, 8, 8, 8), blocks=1, classes=11)))
    found = predictor.lens(_picture(100, 200))
    assert isinstance(found, Division)
    assert (found.u0, found.v0) == (99.5, 49.5)
    assert -1.8 / 100**2 <= found.lambda_ <= 0.2 / 100**2


@pytest.mark.slow
def test_onnx_runtime_agrees_with_torch(network: LaRecNet, tmp_path: Path) -> None:
    runtime = pytest.importorskip("onnxruntime")
    lines, lens = export_onnx(network, tmp_path, size=64)
    image = torch.rand(1, 3, 64, 64)
    with torch.inference_mode():
        expected = network(image)
        assert expected.lineness is not None
    session = runtime.InferenceSession(str(lens), providers=["CPUExecutionProvider"])
    k, _, _, lineness = session.run(None, {"image": image.numpy()})
    np.testing.assert_allclose(k, expected.k.numpy(), atol=1e-5)
    np.testing.assert_allclose(lineness, expected.lineness.numpy(), atol=1e-5)
    session = runtime.InferenceSession(str(lines), providers=["CPUExecutionProvider"])
    other = torch.rand(3, 3, 32, 48)
    heatmap, _ = session.run(None, {"image": other.numpy()})
    with torch.inference_mode():
        own = network.dlp.heatmap(network.dlp(other).raw)
    np.testing.assert_allclose(heatmap, own.numpy(), atol=1e-5)
