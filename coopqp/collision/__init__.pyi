from .bodies import (
    Body as Body,
    Box as Box,
    Capsule as Capsule,
    Cylinder as Cylinder,
    Hull as Hull,
    Mesh as Mesh,
    NearPair as NearPair,
    Sphere as Sphere,
)
from .clearance import Clearance as Clearance
from .pairs import PairRules as PairRules
from .scene import CollisionScene as CollisionScene
