from .bodies import (
    Body as Body,
)
from .bodies import (
    Box as Box,
)
from .bodies import (
    Capsule as Capsule,
)
from .bodies import (
    Cylinder as Cylinder,
)
from .bodies import (
    Hull as Hull,
)
from .bodies import (
    Mesh as Mesh,
)
from .bodies import (
    NearPair as NearPair,
)
from .bodies import (
    Sphere as Sphere,
)
from .clearance import Clearance as Clearance
from .pairs import PairRules as PairRules
from .scene import CollisionScene as CollisionScene
