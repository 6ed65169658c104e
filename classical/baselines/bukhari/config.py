"""Every parameter of the Bukhari–Dailey method, in one frozen dataclass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Centre = Literal["free", "fixed"]


@dataclass(frozen=True)
class BukhariConfig:
    """Parameters of the method; lengths are in pixels of the working picture.

    The authors' thresholds are not known to us in full. The share of the contour length, the blur,
    the trials and the number of triples follow a published arc-based calibration system and a trial
    of our own; see the module `estimate`.

    Attributes:
        centre: "free" estimates the centre of distortion, as the article does; "fixed" keeps it in
            the middle of the picture and estimates λ alone.
        largest_side: Pictures whose longer side is longer are reduced to this first.
        sigma: Standard deviation of the Gaussian of the edge detector.
        low_contrast: Low hysteresis threshold, height of the step in grey levels.
        high_contrast: High hysteresis threshold: a contour reaches it somewhere.
        contour_share: Shortest contour as a share of the picture's longer side.
        arc_trials: Circles tried for each stretch of contour.
        arc_distance: Largest distance t_d of a contour point to the circle of its arc.
        arc_length: Shortest arc L_min.
        most_arcs: Only the longest so many arcs are used.
        triples: Triples of arcs tried for the distortion.
        straight_distance: An undistorted arc is straight if the root mean square of its distances
            to a line is under this, in pixels of the distorted picture.
        score_points: Points of each arc at which straightness is judged.
        least_arcs: Fewer arcs than this that agree are a failed estimate.
        long_arc: So many agreeing arcs must be longer than this, or chance may explain them.
        long_arc_share: Added to `long_arc`, as a share of the picture's longer side: the longest
            chance arcs of blurred noise grow with the picture.
        least_share: Agreeing arcs that make up less than this share of the length of all arcs are
            a failed estimate.
        newton_rounds: Most Levenberg–Marquardt steps.
        tolerance: Relative change of the cost at which these end.
        seed: Seed of the random trials, where no generator is passed.
    """

    centre: Centre = "free"
    largest_side: int | None = 1280
    sigma: float = 1.2
    low_contrast: float = 8.0
    high_contrast: float = 16.0
    contour_share: float = 0.04
    arc_trials: int = 500
    arc_distance: float = 1.0
    arc_length: float = 40.0
    most_arcs: int = 120
    triples: int = 2000
    straight_distance: float = 0.5
    score_points: int = 16
    least_arcs: int = 5
    long_arc: float = 34.0
    long_arc_share: float = 0.03
    least_share: float = 0.15
    newton_rounds: int = 60
    tolerance: float = 1e-9
    seed: int = 0

    def __post_init__(self) -> None:
        if self.centre not in ("free", "fixed"):
            raise ValueError(f'Expected centre "free" or "fixed", got {self.centre!r}.')
        positive = {
            "sigma": self.sigma,
            "arc_trials": self.arc_trials,
            "arc_distance": self.arc_distance,
            "arc_length": self.arc_length,
            "triples": self.triples,
            "straight_distance": self.straight_distance,
        }
        for name, value in positive.items():
            if not value > 0:
                raise ValueError(f"Expected {name} > 0, got {value}.")
        if self.score_points < 3:
            raise ValueError(f"Expected score_points >= 3, got {self.score_points}.")
