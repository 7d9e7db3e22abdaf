"""Forces between the arms and the object: load sharing, internal stress, calibration from a gripped run."""

from coopqp.forces.grips import Grip
from coopqp.forces.load import LoadShare, SharedLoad
from coopqp.forces.use import LoadUse, load_use

__all__ = ["Grip", "LoadShare", "LoadUse", "SharedLoad", "load_use"]
