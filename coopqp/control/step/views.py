"""Errors of the arms' views of the object that differ by twists, however far the object is off its path.

With ``E_k = R⁻¹ O_k`` an arm's view from the reference, a twist ν in the axes of R leads it to ``exp(h ν) E_k`` in a
time h. ``log E_k`` does not change by h ν then, but by ``J⁻¹ h ν`` with the exponential's left Jacobian J at log E_k.
What a step foresees for the next one would be wrong by ``(1 − J⁻¹) h ν``, which from a turn of 109° on is more than
h ν itself: errors would grow from step to step, and the arms part. So where the object is turned by more than
``FAR_OFF`` the errors are

    e_1 = log E_1,    e_k = e_1 + log(E_k E_1⁻¹),

and what all arms have in common is followed by exponentials. Nearer to the path they are the logarithms, which do not
depend on the order of the arms, and what they miss of the twists dies away.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from coopqp.model.chain import Chain
from coopqp.native.constants import FAR_OFF
from coopqp.spatial import Array


def view_errors(O: Sequence[pin.SE3], reference: pin.SE3, first: pin.SE3) -> Array:
    """``e_k`` (N, 6) [m, rad] of views O_k of the object from its reference pose; ``first`` is the first arm's view."""
    E = reference.actInv(first)
    common = pin.log6(E).vector
    if not _far_off(common):
        return Chain.errors(O, reference)
    back = E.inverse()
    return np.array([common + pin.log6(reference.actInv(own) * back).vector for own in O])


def errors_after(errors: Array, ways: Array) -> Array:
    """The errors (N, 6) after each view has moved by a way of its own (N, 6), a twist over a time [m, rad]."""
    first, way = errors[0], ways[0]
    if not _far_off(first):
        return np.asarray(errors + ways)
    common = pin.log6(pin.exp6(way) * pin.exp6(first)).vector - first - way
    return np.asarray(errors + ways + common)


def ways_between(errors: Array, later: Array) -> Array:
    """The ways (N, 6) of the views from errors to later ones: the reverse of :func:`errors_after`."""
    first, last = errors[0], later[0]
    if not _far_off(first):
        return np.asarray(later - errors)
    common = pin.log6(pin.exp6(last) * pin.exp6(first).inverse()).vector - (last - first)
    return np.asarray(later - errors + common)


def _far_off(error: Array) -> bool:
    """Whether the object is turned so far off its path that logarithms of views do not differ by twists."""
    return not error[3:] @ error[3:] < FAR_OFF**2
