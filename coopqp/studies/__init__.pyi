from .dispatch import run_rows as run_rows
from .engines import Cluster as Cluster, Engine as Engine, Local as Local
from .errors import EngineError as EngineError, StudyError as StudyError
from .placed import ArmPlaced as ArmPlaced, CellPlaced as CellPlaced, Goals as Goals
from .placement import PlaceStudy as PlaceStudy, load_place_study as load_place_study
from .placing import Placer as Placer
from .study import Study as Study, load_study as load_study
from .sweeping import Sweep as Sweep, sweep as sweep
