from .bound import LoadBound as LoadBound
from .calibration import (
    ArmCorrection as ArmCorrection,
    Calibration as Calibration,
    CalibrationError as CalibrationError,
    CalibrationOptions as CalibrationOptions,
    calibrate as calibrate,
    undetermined_by as undetermined_by,
)
from .excitation import DeterminingMotion as DeterminingMotion, determining_motion as determining_motion
from .force_controller import ForceController as ForceController
from .force_options import ForceOptions as ForceOptions
from .frictional_contacts import least_squeeze as least_squeeze, palm_use as palm_use, squeeze_needed as squeeze_needed
from .grips import Grip as Grip
from .internal import (
    InternalStress as InternalStress,
    StressModel as StressModel,
    at_tools as at_tools,
    internal_wrenches as internal_wrenches,
)
from .load_sharing import LoadShare as LoadShare
from .sensor_findings import SensorFinding as SensorFinding, SensorJudgement as SensorJudgement
from .shared_load import SharedLoad as SharedLoad
from .utilisation import LoadUse as LoadUse, load_use as load_use
from .wrist_sensor import WristSensor as WristSensor
