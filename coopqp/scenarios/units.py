"""Numbers with their units, for the arguments of scenarios: a study writes the unit on the axis of its figure."""

from __future__ import annotations

from typing import Annotated

from coopqp.checks import Doc

Metres = Annotated[float, Doc("[m]")]
Seconds = Annotated[float, Doc("[s]")]
Radians = Annotated[float, Doc("[rad]")]
Degrees = Annotated[float, Doc("[deg]")]
RadiansPerSecond = Annotated[float, Doc("[rad/s]")]
MetresPerSecond = Annotated[float, Doc("[m/s]")]
RadiansPerSquareSecond = Annotated[float, Doc("[rad/s²]")]
Kilograms = Annotated[float, Doc("[kg]")]
Newtons = Annotated[float, Doc("[N]")]
