from .bound import LoadBound as LoadBound
from .calibration import (
    ArmCorrection as ArmCorrection,
)
from .calibration import (
    Calibration as Calibration,
)
from .calibration import (
    CalibrationError as CalibrationError,
)
from .calibration import (
    CalibrationOptions as CalibrationOptions,
)
from .calibration import (
    calibrate as calibrate,
)
from .calibration import (
    undetermined_by as undetermined_by,
)
from .excitation import DeterminingMotion as DeterminingMotion
from .excitation import determining_motion as determining_motion
from .force_controller import ForceController as ForceController
from .force_options import ForceOptions as ForceOptions
from .frictional_contacts import least_squeeze as least_squeeze
from .frictional_contacts import palm_use as palm_use
from .frictional_contacts import squeeze_needed as squeeze_needed
from .grips import Grip as Grip
from .internal import internal_wrenches as internal_wrenches
from .load_sharing import LoadShare as LoadShare
from .sensor_findings import SensorFinding as SensorFinding
from .sensor_findings import SensorJudgement as SensorJudgement
from .shared_load import SharedLoad as SharedLoad
from .stress import InternalStress as InternalStress
from .stress import StressModel as StressModel
from .stress import at_tools as at_tools
from .utilisation import LoadUse as LoadUse
from .utilisation import load_use as load_use
from .wrist_sensor import WristSensor as WristSensor
