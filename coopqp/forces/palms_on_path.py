"""Palms have to hold an object all along its path, also while only some of them do."""

from __future__ import annotations

import numpy as np

from coopqp.errors import InvalidInputError
from coopqp.forces.force_options import ForceOptions
from coopqp.forces.frictional_contacts import least_squeeze
from coopqp.forces.load_sharing import LoadShare
from coopqp.model.cell import RobotCell
from coopqp.model.grasp import Grasp
from coopqp.paths.path import ObjectPath

#: Clocks along a path at which palms are tried.
_CLOCKS = 21


def check_squeeze(cell: RobotCell, grasp: Grasp, path: ObjectPath, options: ForceOptions) -> None:
    """Refuse palms that could not hold the object at rest along its path.

    Raises:
        InvalidInputError: they could not, or some of them that hold it alone; or nothing is told of what they hold.
    """
    palms = options.palms
    if palms is None:
        return
    if options.payload is None:
        raise InvalidInputError("palms without a payload", "ForceOptions", "Say what they hold.")
    load = LoadShare(cell, grasp, options.payload, internal_force=options.squeeze)
    known = path.known_ahead and np.isfinite(path.duration)
    clocks, motion = np.linspace(0.0, path.duration, _CLOCKS) if known else np.zeros(1), path.grasps
    contact = ((0.0, (True,) * len(cell)),) if motion is None else motion.contact
    ends = [*(at for at, _ in contact[1:]), np.inf]
    for (begin, holds), end in zip(contact, ends, strict=True):
        held = [k for k, holding in enumerate(holds) if holding]
        now = grasp if motion is None else grasp.moved_by(motion.placements(begin))
        own = Grasp(tuple(now.T_object_tool[k] for k in held))
        while_held = [begin, *(t for t in clocks if begin < t < end)] if motion is not None else clocks
        loads = [load.wrench(path.pose(float(t)).rotation) for t in while_held]
        some = "" if all(holds) else f" of {', '.join(cell.arm_names[k] for k in held)} from {begin:.3g} s on"
        try:
            least = least_squeeze([palms[k] for k in held], own, loads)
        except InvalidInputError as error:
            if not some:
                raise
            raise InvalidInputError(
                f"while only the palms{some} hold it: {error}", "ForceController: controller", "Let more arms hold it."
            ) from error
        if options.squeeze < least:
            raise InvalidInputError(
                f"the palms{some} would lose the object: they press with {options.squeeze:g} N, and need {least:.1f} N "
                "at least",
                "ForceOptions: squeeze",
                f"Give {1.2 * least:.0f} N or more.",
            )
