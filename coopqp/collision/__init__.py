"""Nothing touches: shapes of arms, object and surroundings, their distances, and the rows and bounds that keep them.

Import public names from here. The distances come from coal, which comes with Pinocchio.
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.collision.clearance import Clearance
    from coopqp.collision.pairs import PairRules
    from coopqp.collision.scene import CollisionScene
    from coopqp.model.shapes import Body, Box, Capsule, Cylinder, Hull, Mesh, NearPair, Sphere
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.collision.clearance": "Clearance",
            "coopqp.collision.pairs": "PairRules",
            "coopqp.collision.scene": "CollisionScene",
            "coopqp.model.shapes": "Body Box Capsule Cylinder Hull Mesh NearPair Sphere",
        },
    )

__all__ = [
    "Body",
    "Box",
    "Capsule",
    "Clearance",
    "CollisionScene",
    "Cylinder",
    "Hull",
    "Mesh",
    "NearPair",
    "PairRules",
    "Sphere",
]
