from .program import Phase as Phase, PhaseSpan as PhaseSpan, Program as Program
from .roles import (
    Follows as Follows,
    FollowsJoints as FollowsJoints,
    Holds as Holds,
    Role as Role,
    Slides as Slides,
    Travels as Travels,
    Turns as Turns,
    Waits as Waits,
    Works as Works,
)
from .search import SearchedWay as SearchedWay
