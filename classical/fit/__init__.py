"""The straightness fit: curves in, lens out."""

from classical.fit.fitted import fitted_curves as fitted_curves
from classical.fit.observations import Observation as Observation
from classical.fit.observations import of_belief as of_belief
from classical.fit.observations import of_belief_field as of_belief_field
from classical.fit.observations import of_field as of_field
from classical.fit.observations import of_focal as of_focal
from classical.fit.plumb_line import FitConfig as FitConfig
from classical.fit.plumb_line import fit_lens as fit_lens
from classical.fit.prior import LensPrior as LensPrior
from classical.fit.prior import fused as fused
from classical.fit.prior import generic_prior as generic_prior
from classical.fit.quality import predicted_error as predicted_error
from classical.fit.result import FittedCurve as FittedCurve
from classical.fit.result import LensFit as LensFit
from classical.fit.search import SearchConfig as SearchConfig
from classical.fit.solve import SolverConfig as SolverConfig
from classical.fit.vanishing import ScaleEstimate as ScaleEstimate
from classical.fit.vanishing import VanishingConfig as VanishingConfig
from classical.fit.vanishing import scale_from_directions as scale_from_directions
