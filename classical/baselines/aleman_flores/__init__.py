"""The baselines of Alemán-Flores et al., 2014 and 2016."""

from classical.baselines.aleman_flores.config import AlemanFloresConfig as AlemanFloresConfig
from classical.baselines.aleman_flores.config import Variant as Variant
from classical.baselines.aleman_flores.estimate import CITATION as CITATION
from classical.baselines.aleman_flores.estimate import AlemanFloresResult as AlemanFloresResult
from classical.baselines.aleman_flores.estimate import estimate as estimate
