"""The names of `classical.fit` for type checkers; `__init__.py` imports each when it is used."""

from .config import FitConfig as FitConfig
from .estimate import Doubt as Doubt
from .estimate import Estimate as Estimate
from .fitted import fitted_curves as fitted_curves
from .observations import Observation as Observation
from .observations import of_belief as of_belief
from .observations import of_belief_field as of_belief_field
from .observations import of_field as of_field
from .observations import of_focal as of_focal
from .parallels import ParallelsConfig as ParallelsConfig
from .plumb_line import fit_lens as fit_lens
from .prior import LensPrior as LensPrior
from .prior import fused as fused
from .prior import generic_prior as generic_prior
from .quality import LARGEST_ERROR as LARGEST_ERROR
from .quality import predicted_error as predicted_error
from .quality import straight_share as straight_share
from .reach import FALLS_SHORT as FALLS_SHORT
from .reach import within_reach as within_reach
from .result import FittedCurve as FittedCurve
from .result import LensFit as LensFit
from .search import SearchConfig as SearchConfig
from .solve import SolverConfig as SolverConfig
from .vanishing import ScaleEstimate as ScaleEstimate
from .vanishing import VanishingConfig as VanishingConfig
from .vanishing import scale_from_directions as scale_from_directions
