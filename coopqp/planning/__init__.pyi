from .arm_check import ArmCheck as ArmCheck, UndecidedInterval as UndecidedInterval
from .arm_starts import BranchAlongPath as BranchAlongPath
from .branch_checks import BranchCheck as BranchCheck, PathVerdict as PathVerdict
from .check import ClearanceCheck as ClearanceCheck, PathCheck as PathCheck, Remedy as Remedy, check_path as check_path
from .payload import Payload as Payload
from .planner import Plan as Plan, plan as plan
from .program_timing import time_program as time_program
from .remedies import find_remedies as find_remedies
from .route.finding import find_path as find_path
from .route.goals import ArmGoal as ArmGoal, FreeTurn as FreeTurn, TurnedGoal as TurnedGoal
from .route.of_phase import Search as Search
from .route.replanner import Replanner as Replanner
from .route.route import Route as Route, RouteVerdict as RouteVerdict
from .starts import ArmStart as ArmStart, Start as Start, find_start as find_start
from .timing import time_path as time_path
