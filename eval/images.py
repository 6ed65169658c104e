"""PSNR and SSIM of rectified pictures, as the paper's published numbers were made."""

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

PSNR_CAP = 100.0
"""Decibels given to identical pictures, whose PSNR is infinite."""

SSIM_WINDOW = 7
"""Side of the window of SSIM in pixels, the default of scikit-image."""


def psnr(picture: UInt8[ndarray, "h w 3"], truth: UInt8[ndarray, "h w 3"]) -> float:
    """Peak signal-to-noise ratio in dB over all RGB values, data range 255, black kept."""
    if np.array_equal(picture, truth):
        return PSNR_CAP
    return min(PSNR_CAP, float(peak_signal_noise_ratio(truth, picture, data_range=255)))


def ssim(picture: UInt8[ndarray, "h w 3"], truth: UInt8[ndarray, "h w 3"]) -> float:
    """Structural similarity of the grey pictures: uniform 7x7 window, data range 255."""
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (picture, truth)]
    value = structural_similarity(*grey, win_size=SSIM_WINDOW, data_range=255)
    return float(np.asarray(value))
