"""What leads the object from outside, sample by sample: the position of a belt, and the pose of a hand."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import pinocchio as pin

#: Time constant of the belt's filter [s], gain of the object's lag [1/s], and after what silence the object pauses [s].
BELT_FILTER, LAG_GAIN, BELT_SILENCE = 0.02, 20.0, 0.1
#: Time constant of the hand's filter, and after what silence the object pauses [s].
HAND_FILTER, HAND_SILENCE = 0.04, 0.25


@final
@dataclass(frozen=True)
class Gear:
    """A belt whose position the program's clock follows: its alpha-beta filter.

    Attributes:
        position, speed: of the belt now, filtered [s of the program, and per second].
        age: time since the last measured position [s].
    """

    position: float
    speed: float
    age: float = 0.0

    def measured(self, position: float) -> Gear:
        """With a position that is measured now: the filter is critically damped."""
        if self.age <= 0.0:
            return replace(self, position=position)
        left = math.exp(-self.age / BELT_FILTER)
        off = position - self.position
        speed = self.speed + (1.0 - left) ** 2 / self.age * off
        return Gear(self.position + (1.0 - left * left) * off, speed)

    def later(self, dt: float) -> Gear:
        """After a step of a length [s]."""
        return Gear(self.position + self.speed * dt, self.speed, self.age + dt)

    @property
    def silent(self) -> bool:
        """Whether nothing was measured for too long."""
        return self.age > BELT_SILENCE

    def share(self, clock: float) -> float:
        """The largest path speed σ of a step from a clock of the program [s] on."""
        return 0.0 if self.silent else min(max(self.speed + LAG_GAIN * (self.position - clock), 0.0), 1.0)


@final
@dataclass(frozen=True, eq=False)
class Clutch:
    """A hand that leads the object: by how much it has moved since it was engaged.

    Attributes:
        hand: its pose, filtered.
        engaged: the hand's and the object's poses where the object began to follow; None before.
    """

    hand: pin.SE3
    engaged: tuple[pin.SE3, pin.SE3] | None = None

    def measured(self, hand: pin.SE3, elapsed: float) -> Clutch:
        """With a pose that is measured now, a time after the last one [s]."""
        if self.engaged is None:
            return Clutch(hand)
        share = 1.0 - math.exp(-min(elapsed, 1e3) / HAND_FILTER)
        way = np.asarray(pin.log3(self.hand.rotation.T @ hand.rotation))
        R = self.hand.rotation @ pin.exp3(share * way)
        p = self.hand.translation + share * (hand.translation - self.hand.translation)
        return replace(self, hand=pin.SE3(R, p))

    def goal(self, here: pin.SE3) -> tuple[Clutch, pin.SE3]:
        """Where the object should be; at first where it is, so that nothing leaps."""
        first, begun = self.engaged or (self.hand, here)
        R = self.hand.rotation @ first.rotation.T @ begun.rotation
        goal = pin.SE3(R, begun.translation + self.hand.translation - first.translation)
        return replace(self, engaged=(first, begun)), goal
