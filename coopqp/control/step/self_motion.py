"""What self-motion of redundant arms costs beyond its speed, so that no limit shakes them to and fro.

A step's QP is linear in the self-motion, which costs next to nothing. Where a limit binds, the smallest slope of its
joint along the self-motion would be worth all the speed that the accelerations allow: past the place where the slope is
0, and back in the next step, for ever. But the slope changes on the way: joints bend by ``b = −A⁺ Ȧ w`` under the
self-motion ``w = N z``. So a QP whose limits bind with the multipliers λ is solved again with a cost of at least
``½ T λᵀb`` for z, which leads to where the slope is 0 in the time T, and no further. All self-motion of arms that move
together costs as much: z is small where the limits leave it little, and its direction would be made of rounding. The
core's counterpart is ``self_motion.cpp``. See docs/derivations.md.
"""

from __future__ import annotations

import numpy as np

from coopqp.model.chain import Chain
from coopqp.native.constants import APPROACH_STEPS, APPROACH_TIME
from coopqp.spatial import Array


def shrunk_units(chain: Chain, z: Array, columns: Array, pull: Array, h: float) -> Array | None:
    """Shares (r,) of their units that remain: ``columns * this`` replaces the columns; None where they may stay.

    Args:
        chain: linearised and inverted.
        z: self-motions of the QP's solution (r,), each in the unit that makes its cost ½ z².
        columns: joint velocities per unit of each (nv, r).
        pull: multipliers λ of the joints' velocities (nv,), positive at an upper bound.
        h: length of the step [s].
    """
    w, time = columns @ z, max(APPROACH_TIME, APPROACH_STEPS * h)
    units, at = None, 0
    for i, (extra, joints) in enumerate(zip(chain.further, chain.part_columns, strict=True)):
        own, at = z[at : at + extra], at + extra
        size = float(own @ own)
        if not size > 0.0 or chain.parts[i][0] in chain.apart:
            continue
        bend = -chain.inverses[i] @ (chain.part_slope(i, w[joints]) @ w[joints])
        cost = time * float(pull[joints] @ bend) / size
        if cost > 1.0:
            units = np.ones(len(z)) if units is None else units
            units[at - extra : at] = 1.0 / np.sqrt(cost)
    return units
