"""Makes `wild_prior.json`, the statistics behind the `wild` prior, from calibrated wide lenses.

    python -m learned.slf.fit_wild_prior gyroflow_wide.json learned/slf/wild_prior.json

The input is a JSON list of OpenCV-fisheye calibrations (`fx fy cx cy D[4] width height`), such as
an extract of gyroflow/lens_profiles (CC0). Only moments leave this script: no lens is stored.
"""

import json
import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from learned.slf.lens_shape import first_angle, shapes

N_COMPONENTS = 5
_EM_STEPS = 200
_FLOOR = np.diag([1e-3, 1e-5, 2e-5, 4e-5, 6e-5])
_LARGEST_HALF_FIELD = np.radians(112.0)
_LINEAR_MODE_STRIDE = 8


def lens_clouds(lenses: list[dict]) -> tuple[Float[ndarray, "n 5"], Float[ndarray, "n 3"]]:
    """Shapes (Θ at the sensor's corner, l1..l4) and (aspect, u0, v0) in half widths.

    Args:
        lenses: Calibrations; those whose curve does not rise up to the corner are left out.
    """
    rows = [[x["width"], x["height"], x["fx"], x["fy"], x["cx"], x["cy"], *x["D"]] for x in lenses]
    table = np.array([row for row in rows if row[2] > 0], float)
    half = table[:, 0] / 2
    k = (
        np.concatenate([np.ones((len(table), 1)), table[:, 6:10]], 1)
        * (table[:, 2] / half)[:, None]
    )
    rho = np.hypot(1.0, table[:, 1] / table[:, 0])
    field = first_angle(k, rho)
    shape, _ = shapes(k, rho)
    keep = np.isfinite(shape).all(axis=1) & (field < _LARGEST_HALF_FIELD)
    keep &= np.abs(shape[:, 1:] - np.median(shape[keep, 1:], 0)).max(axis=1) < 1.0
    keep &= ~_is_linear_mode(shape) | (np.arange(len(shape)) % _LINEAR_MODE_STRIDE == 0)
    u0 = (table[:, 4] - (table[:, 0] - 1) / 2) / half
    v0 = (table[:, 5] - (table[:, 1] - 1) / 2) / half
    return shape[keep], np.stack([table[:, 3] / table[:, 2], u0, v0], 1)[keep]


def _is_linear_mode(shape: ndarray) -> ndarray:
    """True for in-camera rectified modes: they crowd such files, and one in eight is enough."""
    perspective = np.log(np.tan(np.minimum(shape[:, 0], 1.3)) / np.minimum(shape[:, 0], 1.3))
    return shape[:, 4] > 0.6 * perspective


def gaussian_mixture(
    data: Float[ndarray, "n d"], n_components: int, rng: np.random.Generator
) -> tuple[Float[ndarray, " c"], Float[ndarray, "c d"], Float[ndarray, "c d d"]]:
    """Weights, means and covariances by expectation maximisation, started on random samples."""
    spread = data.std(axis=0)
    means = data[rng.choice(len(data), n_components, replace=False)]
    covariances = np.repeat(np.diag(spread**2)[None], n_components, 0)
    weights = np.full(n_components, 1.0 / n_components)
    for _ in range(_EM_STEPS):
        log_p = np.log(weights) + log_normal(data[:, None], means, covariances)
        share = np.exp(log_p - np.logaddexp.reduce(log_p, axis=1)[:, None])
        mass = share.sum(axis=0) + 1e-9
        weights, means = mass / mass.sum(), share.T @ data / mass[:, None]
        off = data[:, None] - means
        covariances = np.einsum("nc,nci,ncj->cij", share, off, off) / mass[:, None, None] + _FLOOR
    return weights, means, covariances


def log_normal(
    x: Float[ndarray, "n one_or_c d"],
    means: Float[ndarray, "c d"],
    covariances: Float[ndarray, "c d d"],
) -> Float[ndarray, "n c"]:
    """Log density of d-variate normals, shape (n, c)."""
    off = x - means
    inverse, (_, logdet) = np.linalg.inv(covariances), np.linalg.slogdet(covariances)
    distance = np.einsum("nci,cij,ncj->nc", off, inverse, off)
    return -0.5 * (distance + logdet + x.shape[-1] * np.log(2 * np.pi))


def wild_statistics(lenses: list[dict], *, seed: int = 0) -> dict:
    """The moments that `wild` is made of."""
    shape, intrinsics = lens_clouds(lenses)
    weights, means, covariances = gaussian_mixture(shape, N_COMPONENTS, np.random.default_rng(seed))
    low, high = np.percentile(intrinsics, [15.87, 84.13], axis=0)
    wide_low, wide_high = np.percentile(intrinsics, [2.28, 97.72], axis=0)
    return {
        "n_lenses": len(shape),
        "weights": np.round(weights, 5).tolist(),
        "means": np.round(means, 6).tolist(),
        "covariances": np.round(covariances, 8).tolist(),
        "aspect_sigma": [round((high - low)[0] / 2, 5), round((wide_high - wide_low)[0] / 4, 5)],
        "centre_sigma": [
            round(float((high - low)[1:].mean()) / 2, 5),
            round(float((wide_high - wide_low)[1:].mean()) / 4, 5),
        ],
    }


def main(arguments: list[str]) -> None:
    """Read lenses, write statistics."""
    if len(arguments) != 2:
        raise ValueError(f"expected LENSES.json OUT.json, got {len(arguments)} arguments")
    lenses = json.loads(Path(arguments[0]).read_text())
    Path(arguments[1]).write_text(json.dumps(wild_statistics(lenses), indent=1) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
