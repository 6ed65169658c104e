"""One picture, one answer: as many threads as there may be, the lens is the same to 1e-9."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hybrid.methods import method_names

ROOT = Path(__file__).resolve().parents[1]
POOLS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
ANSWER = """
import json, sys, cv2, numpy as np, torch
from hybrid import RectifyConfig, read_picture, rectify
from hybrid.methods import method_names
threads = int(sys.argv[2])
torch.set_num_threads(threads)
room = cv2.resize(read_picture(sys.argv[1]).pixels, (480, 360), interpolation=cv2.INTER_AREA)
told = {}
for method in method_names():
    result = rectify(room, RectifyConfig(method=method, threads=threads), throw=False)
    vector = [] if result.camera is None else result.camera.to_vector().tolist()
    told[method] = {
        "lens": vector,
        "covariance": result.quality.covariance.ravel().tolist(),
        "pixels": result.image.ravel()[::97].tolist(),
    }
print(json.dumps(told))
"""


def answers(threads: int) -> dict[str, dict[str, list[float]]]:
    room = ROOT / "examples" / "room.jpg"
    done = subprocess.run(
        [sys.executable, "-c", ANSWER, room, str(threads)],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | dict.fromkeys(POOLS, str(threads)),
    )
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def pair() -> tuple[dict, dict]:
    return answers(1), answers(2)


@pytest.mark.parametrize("method", method_names())
def test_one_thread_and_two_give_the_same_lens_to_a_billionth(pair, method):
    one, two = (np.array(told[method]["lens"]) for told in pair)
    assert len(one) == (0 if method == "identity" else 9)
    np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-9)
    first, second = (np.array(told[method]["covariance"]) for told in pair)
    np.testing.assert_allclose(first, second, rtol=1e-6, atol=1e-9 * np.abs(first).max())


@pytest.mark.parametrize("method", method_names())
def test_one_thread_and_two_give_the_same_picture(pair, method):
    one, two = (np.array(told[method]["pixels"]) for told in pair)
    assert np.abs(one - two).max() <= 1  # a billionth of a pixel can tip a rounding
