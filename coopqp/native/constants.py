"""Constants that the definition and the core share, listed once: Python reads them here, and the header has them, too.

Names in capitals alone are constants; :mod:`coopqp.native.header` writes them for the core.
"""

from __future__ import annotations

# -- limits ------------------------------------------------------------------------------------------------------------
LIMIT_TOLERANCE = 1e-9  # velocities within this of a limit are admissible, and clipped [rad/s or m/s]
STILL_SLOPE = 1e-12  # per unit of rate, a joint slower than this stands still [rad/s or m/s]
RECOVERY_SHARE = 0.2  # share of a joint's speed at which it is led back from outside its limits
INSIDE = 1e-5  # how far inside its limit such a joint is led [rad or m]
AT_LIMIT = 1e-7  # a velocity this close to its limit stands at it [rad/s or m/s]
RESIDUE_TOLERANCE = 1e-5  # a solver's excess over a limit up to this is clipped; more is a failure [rad/s]
MOST_TIGHTENINGS = 3  # answers with rows that the one before broke by the bend of distances

# -- chain -------------------------------------------------------------------------------------------------------------
SINGULAR_FLOOR = (
    1e-6  # smaller singular values of A_k count as this in an inverse: limits and rate keep commands finite
)
CLOSING = (
    1e-3  # common twists that few joints lack by less than this share, squared, close no chain: they would be large
)
ADMITTED = 1e-8  # twists that few joints lack by less than this, squared, they follow
FEW_FOLLOW = 1e-4  # few joints follow a path if Newton's method leaves no larger error [m, rad]
LARGE_INVERSE = 1e4  # entries of an inverse beyond this need a look at the singular values
SMALLEST_PIVOT = 1e-9  # smallest pivot over the largest entry
WELL_INVERTED = 1e-3  # smallest pivot of an arm that shares joints, whose own inverse serves
LONG_LEVER = 3.0  # an arm further from the object's origin is inverted about a point of its own [m]
LONGEST_STEP = 0.5  # Newton's step is shortened to this [rad or m]

# -- ways of joints ----------------------------------------------------------------------------------------------------
WAY_HEAD = 8  # numbers of a way before its rows
FAR_FROM_WAY = 0.02  # an arm this far from the way of its joints does not follow it [rad or m]

# -- rate --------------------------------------------------------------------------------------------------------------
BRAKING_SHARE = 0.8  # share of the accelerations that braking together is planned with
FASTEST_PATH = 20.0  # a path that moves faster jumps [m/s]; 1 rad counts as TURN_LENGTH
LEAST_PACE = 1e-3  # the increment along the path is the mean over this share of a step at least
MOST_PACES = 4  # answers over another share of the clock, where a step takes another one than expected,
SAME_PACE = 1e-6  # which differs by more than this of itself,
OFF_PACE = 1e-10  # and leads further off the path than this [m]
STANDING = 1e-3  # an increment that grows by less of itself with its share leads to a path that rests
NEGLIGIBLE = 1e-10  # square of an off-path twist that needs no braking distance [m²/s², rad²/s²]
SETTLED = 1e-13  # the first step has settled when its change of velocity moves the joints by less [rad²]
RATE_ROUNDING = 1e-12  # a rate that rises by less stands still: a QP's zero has the solver's rounding
ARRIVING = 10.0  # an object that comes to a stop for good counts as blocked from this many times the rate on
STILL_BLOCKED = 1e-5  # a blocked object counts as blocked until it has gone on by this way of its clock [s],
STILL_SLOWED = 0.05  # a slowed one, where nothing is known ahead, as slowed for so long at its full rate [s]
RESTING_SPEED = 1e-3  # a paused object that leaves its path faster does not rest yet [m/s],
RESTING_SPIN = 1e-2  # or by this [rad/s]
BISECTIONS = 40  # of a share that breaks rows least
CALM = 1e-10  # where the chain may part, self-motion costs no less than this share of it
LARGEST_X = 1e5  # an infeasibility has to cover unknowns of the QP up to this, in their units
EXTRA_AT_START = 3  # linearisations of a first or long step beyond the others
FAR_OFF = 1.0  # an object that is turned further off its path has errors that differ by twists [rad]
LONG_STEP = 0.03  # a step that moves a joint further is linearised again [rad or m]
BENT_STEP = 1e-6  # so is one whose linearisation errs by more [rad²]
LARGEST_MOVE = 0.05  # a joint with neither velocity nor acceleration limit moves by this in a step [rad or m]
HELD_SPEED = 1.0  # a hold brakes it to this speed [rad/s or m/s],
HELD_SHARE = 0.5  # each step to this share of the speed before

# -- braking together --------------------------------------------------------------------------------------------------
EDGE_SHARE = 0.8  # share of the accelerations that braking together is planned with, ahead of an edge
SINGULAR_MARGIN = 0.01  # least singular value of a tool Jacobian that arms keep
BEND_SHARE = 0.7  # share of the accelerations that the chain's bend may take,
BEND_OFF_PATH = 0.4  # and off the path, where bodies push
APPROACH_TIME = 0.05  # an edge is approached no faster than its room over this time [s],
APPROACH_STEPS = 5.0  # and over this many steps
GIVES_WAY = 0.1  # how far such a row gives way, per unit of a row of the rank CLEARANCE,
BEND_GIVES_WAY = 10.0  # and that of the chain's bend off the path: rather than let a body touch,
BEND_GIVES_WAY_TO = 20.0  # unless the bend takes this many times the accelerations: near singularities arms would part
FASTEST_JOINT = 1e9  # stands for the speed of a joint without velocity limit [rad/s or m/s]
MOST_SWEEPS = 12  # of Jacobi's rotations
SMALL_ROTATION = 1e-16  # entries this small over the trace need none

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
PASSABLE = 0.3  # a singularity is passed where the rate's cap stays above this share of singular_rate
GROWTH = 2.0  # an interval is longer than the one before by this factor at most
FINE_CELL = 1e-3  # intervals shorter than this are not halved for a change of slope [s],
FINE_BEND = 0.05  # but for a change of q″ by more than this share, while the object takes longer for them
OTHER_BRANCH = 0.5  # a slope that changes by more than this share within a fine interval is of another branch
STEPS_TO_EDGE = 2  # an arm's joints would take this many steps to the end of its reach
BRANCH_WAY = 2.0  # an arm this many joint steps from the end of its reach may be past it
FAR_EDGE = 1e3  # the end of an arm's reach is no further than this, in units of its joints
FAR_PIVOT = 0.1  # an arm whose smallest pivot is larger is far from the end of its reach,
FAR_ROOM = 0.02  # where no joint needs more than this to there [rad or m]
EIGEN_ROUNDING = 1e-15  # smallest pivot over the trace
EIGEN_STEPS = 3  # of inverse iteration
BEND_CHANGE = 0.3  # intervals are halved where q″ changes by more than this share of the accelerations
CROSSED = 1e-13  # the lower bound of σ̇ is above the upper one by more than rounding
MOST_PIVOTS = 50  # Newton steps of one program of two variables
KNOTS_PER_PASS = 4  # knots per backward pass
LIMIT_MARGIN = 0.003  # self-motion keeps joints inside their limits by this distance [rad or m]
TURNING_WAY = 0.02  # within this way before they turn away [rad or m]
LEADS = 1e-4  # a joint that its arm's self-motion moves by a smaller share cannot be led away, unless it bends away
IN_PLANE = 1e-8  # with a smaller share an elbow is in its arm's plane: either way round bends the joint alike
TURNS_WELL = 0.1  # a joint turns well by a self-motion of unit speed where its slope is larger [1]
ELBOW_GAIN = 5.0  # redundant arms come nearer to a given motion by this share per second of the clock [1/s]
MOST_GUESSES = 44  # guesses of the largest rate
SHORT_OF = 1e-14  # share by which they stay below a line's
SHORTER = 4.0  # that share grows by this factor after a guess that was too large
LEAST_RATE = 1e-9  # a smaller rate is 0
JUST_BEFORE = 1e-10  # the twist before a corner is taken this much earlier [s]
STEPS_TO_GROW = 8  # a knot is begun this many steps before it is needed
NEWTON_STEPS_AT_START = 1000  # Newton steps that a reset may take
LONGEST_WAY = 300  # knots of a way past a singularity
KINK_CELL = 2e-3  # where an interval this short is too long, a user's path or its twist may jump [s]
SAME_CLOCK = 1e-9  # clocks this close to each other are the same [s]
SAME_AXIS = 1e-24  # turns are about one axis where the squared sine of the angle between their axes is below this
KINK_WIDTH = 2.5e-11  # a twist that changes within so short a time jumps there [s],
KINK_SHARE = 0.5  # by more than this share of its change,
LEAST_KINK = 1e-9  # and by more than this [m/s]
JUMP_WIDTH = 1e-6  # a path that changes faster than FASTEST_PATH, most of it within so short a time, jumps [s],
STEEP_WIDTH = 2.5e-11  # it is too steep, and jumps not, if most of that needs more than this time [s],
STEEP_SHARE = 1e-15  # or than this share of the clock
LEAST_JUMP = 5e-5  # if it is by more than this [m]
BESIDE_KINK = 2e-5  # a twist by finite differences jumps this much before and after the path, at most [s]
LEAST_ASKED = 4  # a user's path is asked up to this often in a step for what is ahead,
ASKED_PER_TIME = 6000.0  # and more often in steps [1/s]
SHORT_STEP = 0.002  # that are longer than this [s],
STEPS_TO_ASK = 40  # and a knot of it is begun this many steps before it is needed
MOST_TRIES = 4  # Newton steps that a knot may take
STARTING_STEPS = 8  # Newton steps that the first knot may take
CONVERGED = 1e-5  # Newton steps shorter than this are the last [rad or m]

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

# -- supervision -------------------------------------------------------------------------------------------------------
STILL_COMMAND = 1e-5  # commanded motion of an arm below this says nothing of a stall [rad or m]
FOLLOWS = 0.5  # an arm that moves by more than this share of its command follows it
CAUGHT_UP = 5e-4  # a stalled arm this close to its command has caught up [rad or m]
CAUGHT_UP_SHARE = 0.3  # so has one at this share of the largest gap
CIRCLE_TOLERANCE = 0.05  # how far (cos, sin) of a continuous joint may be from the unit circle
LET_GO = 0.5  # a force that held the object lets it go below this share of its limit
EQUALLY_FAR = 1e-6  # arms this little apart in their distances count as equally far from their commands [m]
FAULT_SAMPLES = 2  # a fault needs as many samples in a row
MOST_LOST = 3  # samples in a row that an arm may repeat before it counts as standing
NOISE_TIME = 0.2  # noise is averaged over this time [s]
SAID_APART = 1e-5  # arms commanded further apart are named [m]
TOGETHER_AGAIN = 0.5  # share of the distance at which they were held from which on they go on
ALIKE = 1.0 + 1e-9  # the first of arms equally far from the others is named
NO_MISMATCH = 1e-12  # a smaller mismatch is none [m, rad]
FEW_SAMPLES = 4  # fewer samples tell nothing of the noise

# -- drift of the arms from each other ---------------------------------------------------------------------------------
WANDER = 1e-3  # how far a drift wanders within a second [m]
LAG = 0.02  # lag that an arm may have [s]
LEAST_LAG = 1e-4  # how well the lag is known at best [s]
DRIFT_FLOOR = 5e-4  # how well distances are known without noise [m]
DRIFT_SAMPLE = 1e-3  # per this time [s]
SMOOTHING = 0.1  # distances and speed are smoothed alike [s]
DRIFT_PERIOD = 0.0045  # the filter runs this often, or at every step if that is longer [s]
LARGEST_SLOPE = 0.02  # a drift grows by no more than this share of the arms' way

# -- forces from the servos --------------------------------------------------------------------------------------------
STRUCTURE = 2e-9  # compliance of what servos do not model [m/N]; 1 rad counts as 1 m
TURN_LENGTH = 0.3  # 1 rad of turning counts as this many metres where directions are compared
AT_REST = 1e-3  # commanded joint velocities below this are rest [rad/s or m/s]
SERVOS_SETTLED = 0.2  # after this long at rest servos have settled [s]
UNBALANCED = 0.3  # share of the largest wrench from which on wrenches do not cancel
PACE_TIME = 0.01  # the pace of a force is seen over this time [s]
SOON = 0.025  # a force from LET_GO of the limit on holds where its pace would bring it there in this time [s]
STRAIGHT_BACK = 0.95  # cosine from which on an arm's way back is taken for the cause

# -- forces from the sensors -------------------------------------------------------------------------------------------
CONTACT_ROOM = 0.02  # an object that has met something goes back by no more than this [m],
CONTACT_WAY = 0.2  # and what it goes in this time [s]
SERVO_SLOWS = 6e-4  # an arm this far from where its wrench puts its servos slows the object,
SERVO_HOLDS = 1.2e-3  # and holds it from this on [m]
SERVO_LATE = 4e-4  # and per acceleration of the joints, for what damping and late wrenches make of it [s²]
SERVO_PEAK = 0.05  # an acceleration is remembered for this time [s]
HASTE_FILTER = 0.03  # accelerations are filtered: a single step of arms that relax is none [s]
LAG_FLOOR = 1e-3  # arms that are farther from where any lag would put them have an arm that has stopped [m],
LAG_HOLDS = 5e-4  # and are held from this on beyond it [m]
LAG_LATE = 2e-4  # and per acceleration of the object [s²]
LAG_FOLLOWS = 0.015  # for which the lag makes itself felt this much later [s]
LAG_SLOWEST = 5e-3  # slower objects show no lag [m/s]
LONGEST_LAG = 0.15  # [s]
LAG_LEARNS = 0.2  # what LAG does not explain in this time at the start shows how soft drives are [s]
LAG_SETTLES = 0.1  # what the deviation is at rest is averaged over this time [s]
GROWS = 2e-3  # closures of rigid grips also drift as fast as the object grows [m/s]
SOFTEST = 0.05  # servos count as no softer than this share of what they are told to be
CAP_FALLS = 0.1  # the cap by arms out of step falls from 1 to 0 in this time: a jolt is a force of its own [s]
LOOK_EVERY = 0.1  # time between two looks at the compliances, which change with the configuration [s]
MOST_MINDING = 64  # arms

# -- sizes of the memory -----------------------------------------------------------------------------------------------
MOST_KNOTS = 1024  # that the look-ahead keeps
MOST_TRAVELS = 32  # ends of steps that are kept for the trail until it is read
MOST_JOINTS = 64  # of an arm
MOST_SHARING = 8  # arms of one group, which share joints,
MOST_GROUP_JOINTS = 64  # and joints of all of them
MOST_SHARED = 6  # a group with more joints that are shared is not inverted arm by arm
MOST_KINKS = 64  # clocks at which the twist of a user's path was found to jump, that are kept
SEGMENT = 29  # numbers of a segment, see ObjectPath.packed
SHIFT = 8  # numbers of a shift of the path, see unshifted
GRASP_PIECE = 53  # numbers of a piece of a tool's motion on the object, see GraspMotion.packed
