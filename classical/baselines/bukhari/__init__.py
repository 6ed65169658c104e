"""The baseline of Bukhari & Dailey, 2013."""

from classical.baselines.bukhari.arcs import Arc as Arc
from classical.baselines.bukhari.config import BukhariConfig as BukhariConfig
from classical.baselines.bukhari.estimate import CITATION as CITATION
from classical.baselines.bukhari.estimate import BukhariResult as BukhariResult
from classical.baselines.bukhari.estimate import estimate as estimate
from classical.baselines.bukhari.estimate import estimate_from_arcs as estimate_from_arcs
