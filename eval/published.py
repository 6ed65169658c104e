"""Numbers that the authors published, on their own data: shown apart from ours, never mixed."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PublishedRow:
    """One row of a table of Xue et al., Fisheye Distortion Rectification from Deep Straight Lines.

    Attributes:
        name: Method as the paper calls it.
        psnr: Decibels.
        ssim: Structural similarity.
        f: F-score of the line maps, or `None` where the paper has none.
        rpe: Reprojection error in pixels, or `None` where the paper has none.
    """

    name: str
    psnr: float
    ssim: float
    f: float | None
    rpe: float | None


SLF = (
    PublishedRow("Bukhari", 9.34, 0.18, 0.29, 164.75),
    PublishedRow("Alemán-Flores", 10.23, 0.26, 0.30, 125.42),
    PublishedRow("Rong et al.", 12.92, 0.32, 0.33, 121.69),
    PublishedRow("FishRectNet (its own data)", 14.96, 0.41, None, None),
    PublishedRow("LaRecNet, SLF", 28.06, 0.90, 0.82, 0.33),
    PublishedRow("LaRecNet, SLF_wf", 24.73, 0.77, 0.81, 0.38),
    PublishedRow("LaRecNet, SLF_sun", 15.03, 0.43, 0.30, 25.42),
)
"""Table "Quantitative evaluation on the proposed SLF dataset" (2,163 test samples, not public)."""

FISHEYE_VIDEO = (
    PublishedRow("Bukhari", 9.84, 0.16, None, 156.3),
    PublishedRow("Alemán-Flores", 10.72, 0.30, None, 125.31),
    PublishedRow("Rong et al.", 11.81, 0.30, None, 125.31),
    PublishedRow("LaRecNet, SLF", 22.34, 0.82, None, 1.68),
    PublishedRow("LaRecNet, SLF_wf", 19.86, 0.67, None, 1.91),
    PublishedRow("LaRecNet, SLF_sun", 11.34, 0.39, None, 120.12),
)
"""Table "Quantitative evaluation on the fisheye video dataset": real lenses."""

ABLATION = {
    "bl1": PublishedRow("BL1: I_f", 16.24, 0.61, None, 4.51),
    "bl2": PublishedRow("BL2: L_f", 18.61, 0.62, None, 2.08),
    "bl3": PublishedRow("BL3: I_f + L_f", 21.29, 0.68, None, 1.35),
    "bl4": PublishedRow("BL4: + multi-scale", 25.65, 0.80, None, 0.91),
    "bl5": PublishedRow("BL5: + L_geo", 27.83, 0.88, None, 0.43),
    "bl6": PublishedRow("BL6: + L_pix", 28.46, 0.90, None, 0.33),
}
"""Table "Ablation study of the proposed method on SLF dataset", by the tag of the variant."""
