"""Forces between the arms and the object: load sharing, internal stress, calibration from gripped runs.

What most users need is in :mod:`coopqp`. The names here share a load, and plan the motion for a calibration.
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.forces.bound import LoadBound
    from coopqp.forces.calibration import ArmCorrection, undetermined_by
    from coopqp.forces.excitation import DeterminingMotion, determining_motion
    from coopqp.forces.frictional_contacts import least_squeeze, palm_use, squeeze_needed
    from coopqp.forces.grips import Grip
    from coopqp.forces.internal import internal_wrenches
    from coopqp.forces.load_sharing import LoadShare
    from coopqp.forces.sensor_findings import SensorFinding, SensorJudgement
    from coopqp.forces.shared_load import SharedLoad
    from coopqp.forces.utilisation import load_use
    from coopqp.forces.wrist_sensor import WristSensor
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.forces.bound": "LoadBound",
            "coopqp.forces.calibration": "ArmCorrection undetermined_by",
            "coopqp.forces.excitation": "DeterminingMotion determining_motion",
            "coopqp.forces.grips": "Grip",
            "coopqp.forces.internal": "internal_wrenches",
            "coopqp.forces.load_sharing": "LoadShare",
            "coopqp.forces.sensor_findings": "SensorFinding SensorJudgement",
            "coopqp.forces.shared_load": "SharedLoad",
            "coopqp.forces.frictional_contacts": "least_squeeze palm_use squeeze_needed",
            "coopqp.forces.utilisation": "load_use",
            "coopqp.forces.wrist_sensor": "WristSensor",
        },
    )

__all__ = [
    "ArmCorrection",
    "DeterminingMotion",
    "Grip",
    "LoadBound",
    "LoadShare",
    "SensorFinding",
    "SensorJudgement",
    "SharedLoad",
    "WristSensor",
    "determining_motion",
    "internal_wrenches",
    "least_squeeze",
    "load_use",
    "palm_use",
    "squeeze_needed",
    "undetermined_by",
]
