"""The posture task of redundant arms: a target, the middle of the joints' ranges, manipulability."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from coopqp.checks import Doc, documented, keep_scalars


@documented
@dataclass(frozen=True, kw_only=True, eq=False)
class PostureOptions:
    """Weights of the goals of the posture task. All act in the null-space of the chain and never disturb it."""

    gain: Annotated[float, Doc("gain towards 'target' [1/s]")] = 1.0
    target: Annotated[Any, Doc("preferred configuration (nq,); None for the configuration at reset")] = None
    centring: Annotated[float, Doc("gain towards the middle between the position limits [1/s]")] = 0.0
    manipulability: Annotated[float, Doc("gain along the gradient of √det(J Jᵀ) [rad²/s]")] = 0.0
    speed_share: Annotated[
        float, Doc("upper bound of the wanted null-space velocity, as a share of every joint's speed limit")
    ] = 0.2

    @property
    def asks(self) -> bool:
        """Whether a goal other than the default one is asked for."""
        return self.target is not None or (self.gain, self.centring, self.manipulability) != (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        keep_scalars(self, "gain", "centring", "manipulability", open_low=False)
        keep_scalars(self, "speed_share", high=1.0)
