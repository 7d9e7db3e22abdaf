from .cause import Cause as Cause
from .rate import Knot as Knot
from .rate import RateBound as RateBound
from .velocity import Rank as Rank
from .velocity import VelocityConstraint as VelocityConstraint
