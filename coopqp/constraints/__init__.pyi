from .cause import Cause as Cause
from .rate import Knot as Knot, RateBound as RateBound
from .velocity import Rank as Rank, VelocityConstraint as VelocityConstraint
