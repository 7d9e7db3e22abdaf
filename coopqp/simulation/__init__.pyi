from .engine import engine_controller as engine_controller, engine_plant as engine_plant, run_in_engine as run_in_engine
from .evaluation.assessment import Finding as Finding, Tolerances as Tolerances, evaluate as evaluate
from .evaluation.calibration_runs import calibrate_runs as calibrate_runs
from .evaluation.closeness import Closeness as Closeness, Closest as Closest
from .evaluation.metrics import (
    Readings as Readings,
    chain_error as chain_error,
    limit_excess as limit_excess,
    object_error as object_error,
    path_error as path_error,
    read_run as read_run,
    relative_orientation_error as relative_orientation_error,
    relative_positioning_error as relative_positioning_error,
    tool_placements as tool_placements,
)
from .evaluation.monitor import Monitor as Monitor, Monitored as Monitored, check_run as check_run
from .evaluation.violations import (
    Verdict as Verdict,
    Violation as Violation,
    ViolationKind as ViolationKind,
)
from .evaluation.wrenches import RunLoads as RunLoads, WrenchBounds as WrenchBounds, read_loads as read_loads
from .events import (
    Event as Event,
    differs_from as differs_from,
    events_of as events_of,
    operating as operating,
)
from .plants.disturbances import Disturbances as Disturbances, misplaced as misplaced
from .plants.kinematic import DisturbedPlant as DisturbedPlant, KinematicPlant as KinematicPlant, Plant as Plant
from .plants.physics import PhysicsError as PhysicsError, PhysicsPlant as PhysicsPlant
from .plants.physics_options import Interpolation as Interpolation, PhysicsOptions as PhysicsOptions
from .plants.replay import (
    Motion as Motion,
    Replay as Replay,
    exact_motion as exact_motion,
    recorded_motion as recorded_motion,
)
from .recording.recording import Recording as Recording, RecordingError as RecordingError
from .recording.scene import SceneError as SceneError, describe_object as describe_object
from .simulate import simulate as simulate
