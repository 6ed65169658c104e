"""Published methods to compare with: Bukhari & Dailey 2013, Alemán-Flores et al. 2014 and 2016.

Each is a package with its parameters in one frozen dataclass, `estimate(image, config=...)` and a
result that says "ok" or "failed" with a reason and keeps what the method saw on the way.
"""

from classical.baselines.two_parameter import TwoParameterDivision as TwoParameterDivision
