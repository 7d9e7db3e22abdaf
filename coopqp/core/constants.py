"""Constants that the core and Python share, listed once: Python reads them here, and the header has them, too.

Names in capitals alone are constants; :mod:`coopqp.core.header` writes them for the core.
"""

from __future__ import annotations

# -- limits ------------------------------------------------------------------------------------------------------------
STILL_SLOPE = 1e-12  # per unit of rate, a joint slower than this stands still [rad/s or m/s]
RECOVERY_SHARE = 0.2  # share of a joint's speed at which it is led back from outside its limits
INSIDE = 1e-5  # how far inside its limit such a joint is led [rad or m]
MOST_TIGHTENINGS = 3  # answers with rows that the one before broke by the bend of distances

# -- chain -------------------------------------------------------------------------------------------------------------
SINGULAR_FLOOR = (
    1e-6  # smaller singular values of A_k count as this in an inverse: limits and rate keep commands finite
)
LARGE_INVERSE = 1e4  # entries of an inverse beyond this need a look at the singular values
LONGEST_STEP = 0.5  # Newton's step is shortened to this [rad or m]

# -- ways of joints ----------------------------------------------------------------------------------------------------
WAY_HEAD = 8  # numbers of a way before its rows
FAR_FROM_WAY = 0.02  # an arm this far from the way of its joints does not follow it [rad or m]

# -- rate --------------------------------------------------------------------------------------------------------------
BRAKING_SHARE = 0.8  # share of the accelerations that braking together is planned with
FASTEST_PATH = 20.0  # a path that moves faster jumps [m/s]; 1 rad counts as TURN_LENGTH
RATE_ROUNDING = 1e-12  # a rate that rises by less stands still: a QP's zero has the solver's rounding
CALM = 1e-10  # where the chain may part, self-motion costs no less than this share of it
LARGEST_X = 1e5  # an infeasibility has to cover unknowns of the QP up to this, in their units
LARGEST_MOVE = 0.05  # a joint with neither velocity nor acceleration limit moves by this in a step [rad or m]
HELD_SPEED = 1.0  # a hold brakes it to this speed [rad/s or m/s],
HELD_SHARE = 0.5  # each step to this share of the speed before

# -- clearances of bodies ----------------------------------------------------------------------------------------------
WATCHED = 0.1  # pairs are asked within this of their margin in a step at most [m],
WATCHED_BLIND = 0.3  # and within this where nothing is known ahead
BEND_SAMPLE = 5e-4  # a pair is asked between knots or at a step's end where its bodies move by more [m]
BENT_WAY = 1.02  # the joints' way between knots is no longer than this many times the straight one
STANDING = 1e-9  # a distance that falls by less stands still [m]
LEAST_CLEARANCE = 1e-9  # a clearance that counts as none [m]
DEEPEST = -1.0  # where bodies overlap coal's search may fail, and answers the smallest number that there is [m]
EVADES_EARLY = 0.05  # evasion begins this far beyond the comfort, gently [m]
GENTLE = 0.1  # missing speed of a distance up to which evasion grows with its square [m/s]
# With 1000 arms swung past posts at many times their speeds, along slopes that the look-ahead cannot follow.
YIELDS = 50.0  # a row of evasion that is broken by the inverse costs as much as a self-motion of 1
HELPS = 1e-6  # a self-motion that changes no distance by more does not help [m per unit of joint speed]
SMALL_CLEARANCE = 1e-6  # a start this far inside a margin is outside it but for rounding [m]
FARTHEST_POINT = 1e9  # nearest points beyond this are none: that search has failed [m]

# -- rounded corners ---------------------------------------------------------------------------------------------------
RAMP_AT_MIDDLE = 3.0 / 16.0  # largest value of a blend's ramp before its middle, as a share of its half length
NO_CORNER = 1e-9  # twists per unit of s that differ by no more make no corner [1, rad/m]
SHORTEST_LINE = 1e-12  # a shorter line between two blends is left out [m]

# -- preview -----------------------------------------------------------------------------------------------------------
STEPS_TO_FULL_SPEED = 22  # steps in which a joint without acceleration limit is planned to reach full speed
STEPS_TO_EDGE = 2  # an arm's joints would take this many steps to the end of its reach
SAME_CLOCK = 1e-9  # clocks this close to each other are the same [s]
KINK_WIDTH = 2.5e-11  # a twist that changes within so short a time jumps there [s],
KINK_SHARE = 0.5  # by more than this share of its change,
LEAST_KINK = 1e-9  # and by more than this [m/s]
JUMP_WIDTH = 1e-6  # a path that changes faster than FASTEST_PATH, most of it within so short a time, jumps [s],
STEEP_WIDTH = 2.5e-11  # it is too steep, and jumps not, if most of that needs more than this time [s],
STEEP_SHARE = 1e-15  # or than this share of the clock
LEAST_JUMP = 5e-5  # if it is by more than this [m]

# -- new targets -------------------------------------------------------------------------------------------------------
STILL_OBJECT = 1e-6  # an object this slow rests [m/s, rad/s]
NOWHERE = 1e-9  # length of the shortest way [s, at full speed]
SHORTEST_CHANGE = 1e-4  # the shortest time in which the motion changes [s]
CHANGE_SHARE = 0.7  # share of the accelerations that a change of the motion is planned with
LARGEST_JUMP = (
    2.0 / STEPS_TO_FULL_SPEED
)  # share of its speed by which a joint without acceleration limit jumps then, at most
SPEEDS = 50  # shares of the full speed that are compared
RATE_TOLERANCE = 1e-9  # a rate that falls by less does not fall

# -- drift of the arms from each other ---------------------------------------------------------------------------------
LAG = 0.02  # lag that an arm may have [s]

# -- forces from the servos --------------------------------------------------------------------------------------------
STRUCTURE = 2e-9  # compliance of what servos do not model [m/N]; 1 rad counts as 1 m
TURN_LENGTH = 0.3  # 1 rad of turning counts as this many metres where directions are compared

# -- forces from the sensors -------------------------------------------------------------------------------------------
LONGEST_LAG = 0.15  # [s]
LOOK_EVERY = 0.1  # time between two looks at the compliances, which change with the configuration [s]
MOST_MINDING = 64  # arms

# -- sizes of the memory -----------------------------------------------------------------------------------------------
MOST_KNOTS = 1024  # that the look-ahead keeps
MOST_TRAVELS = 32  # ends of steps that are kept for the trail until it is read
MOST_JOINTS = 64  # of an arm
MOST_SHARING = 8  # arms of one group, which share joints,
MOST_GROUP_JOINTS = 64  # and joints of all of them
SEGMENT = 29  # numbers of a segment, see ObjectPath.packed
SHIFT = 8  # numbers of a shift of the path, see unshifted
GRASP_PIECE = 53  # numbers of a piece of a tool's motion on the object, see GraspMotion.packed
