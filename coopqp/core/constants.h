/* Constants that several files read, or Python, too: binding/constants.cpp hands it those. Those of one file stand in it. */

#ifndef COOPQP_CONSTANTS_H
#define COOPQP_CONSTANTS_H

/* -- limits ---------------------------------------------------------------------------------------------------------- */
constexpr double STILL_SLOPE = 1e-12; /* per unit of rate, a joint slower than this stands still [rad/s or m/s] */
constexpr double RECOVERY_SHARE = 0.2; /* share of a joint's speed at which it is led back from outside its limits */
constexpr double INSIDE = 1e-5; /* how far inside its limit such a joint is led [rad or m] */
constexpr double LIMIT_TOLERANCE = 1e-9; /* velocities within this of a limit are admissible, and clipped [rad/s or m/s] */
constexpr double FASTEST_JOINT = 1e9; /* stands for the speed of a joint without velocity limit [rad/s or m/s] */
constexpr double APPROACH_TIME = 0.05; /* an edge is approached no faster than its room over this time [s], */
constexpr double APPROACH_STEPS = 5.0; /* and over this many steps */

/* -- chain ----------------------------------------------------------------------------------------------------------- */
constexpr double SINGULAR_FLOOR = 1e-6; /* smaller singular values of A_k count as this in an inverse: commands stay finite */
constexpr double LARGE_INVERSE = 1e4; /* entries of an inverse beyond this need a look at the singular values */
constexpr double LONGEST_STEP = 0.5; /* Newton's step is shortened to this [rad or m] */
constexpr int MOST_SHARED = 6; /* a group with more joints that are shared is not inverted arm by arm */

/* -- ways of joints -------------------------------------------------------------------------------------------------- */
constexpr int WAY_HEAD = 8; /* numbers of a way before its rows */
constexpr double FAR_FROM_WAY = 0.02; /* an arm this far from the way of its joints does not follow it [rad or m] */

/* -- rate ------------------------------------------------------------------------------------------------------------ */
constexpr double BRAKING_SHARE = 0.8; /* share of the accelerations that braking together is planned with */
constexpr double FASTEST_PATH = 20.0; /* a path that moves faster jumps [m/s]; 1 rad counts as TURN_LENGTH */
constexpr double RATE_ROUNDING = 1e-12; /* a rate that rises by less stands still: a QP's zero has the solver's rounding */
constexpr double LARGEST_X = 1e5; /* an infeasibility has to cover unknowns of the QP up to this, in their units */
constexpr double LARGEST_MOVE = 0.05; /* a joint with neither velocity nor acceleration limit moves by this in a step [rad or m] */
constexpr double HELD_SPEED = 1.0; /* a hold brakes it to this speed [rad/s or m/s], */
constexpr double HELD_SHARE = 0.5; /* each step to this share of the speed before */

/* -- clearances of bodies -------------------------------------------------------------------------------------------- */
constexpr double WATCHED = 0.1; /* pairs are asked within this of their margin in a step at most [m], */
constexpr double WATCHED_BLIND = 0.3; /* and within this where nothing is known ahead */
constexpr double BEND_SAMPLE = 5e-4; /* a pair is asked between grid points or at a step's end where its bodies move by more [m] */
constexpr double BENT_WAY = 1.02; /* the joints' way between grid points is no longer than this many times the straight one */
constexpr double STANDING = 1e-9; /* a distance that falls by less stands still [m] */
constexpr double LEAST_CLEARANCE = 1e-9; /* a clearance that counts as none [m] */
constexpr double DEEPEST = -1.0; /* where bodies overlap coal's search may fail, and answers the smallest number that there is [m] */
constexpr double EVADES_EARLY = 0.05; /* evasion begins this far beyond the comfort, gently [m] */
constexpr double GENTLE = 0.1; /* missing speed of a distance up to which evasion grows with its square [m/s] */
/* With 1000 arms swung past posts at many times their speeds, along slopes that the look-ahead cannot follow. */
constexpr double YIELDS = 50.0; /* a row of evasion that is broken by the inverse costs as much as a self-motion of 1 */
constexpr double HELPS = 1e-6; /* a self-motion that changes no distance by more does not help [m per unit of joint speed] */
constexpr double SMALL_CLEARANCE = 1e-6; /* a start this far inside a margin is outside it but for rounding [m] */
constexpr double FARTHEST_POINT = 1e9; /* nearest points beyond this are none: that search has failed [m] */

/* -- rounded corners ------------------------------------------------------------------------------------------------- */
constexpr double RAMP_AT_MIDDLE = 3.0 / 16.0; /* largest value of a blend's ramp before its middle, as a share of its half length */
constexpr double NO_CORNER = 1e-9; /* twists per unit of s that differ by no more make no corner [1, rad/m] */
constexpr double SHORTEST_LINE = 1e-12; /* a shorter line between two blends is left out [m] */

/* -- preview --------------------------------------------------------------------------------------------------------- */
constexpr int STEPS_TO_FULL_SPEED = 22; /* steps in which a joint without acceleration limit is planned to reach full speed */
constexpr double SAME_CLOCK = 1e-9; /* clocks this close to each other are the same [s] */
constexpr double KINK_WIDTH = 2.5e-11; /* a twist that changes within so short a time jumps there [s], */
constexpr double KINK_SHARE = 0.5; /* by more than this share of its change, */
constexpr double LEAST_KINK = 1e-9; /* and by more than this [m/s] */
constexpr double JUMP_WIDTH = 1e-6; /* a path that changes faster than FASTEST_PATH, most of it within so short a time, jumps [s], */
constexpr double STEEP_WIDTH = 2.5e-11; /* it is too steep, and jumps not, if most of that needs more than this time [s], */
constexpr double STEEP_SHARE = 1e-15; /* or than this share of the clock */
constexpr double LEAST_JUMP = 5e-5; /* if it is by more than this [m] */
constexpr int MOST_KINKS = 64; /* clocks at which the twist of a user's path was found to jump, that are kept */
constexpr double JUST_BEFORE = 1e-10; /* the twist before a corner is taken this much earlier [s] */
constexpr int NEWTON_STEPS_AT_START = 1000; /* Newton steps that a reset may take */

/* -- new targets ----------------------------------------------------------------------------------------------------- */
constexpr double STILL_OBJECT = 1e-6; /* an object this slow rests [m/s, rad/s] */
constexpr double NOWHERE = 1e-9; /* length of the shortest way [s, at full speed] */
constexpr double SHORTEST_CHANGE = 1e-4; /* the shortest time in which the motion changes [s] */
constexpr int SPEEDS = 50; /* shares of the full speed that are compared */
constexpr double RATE_TOLERANCE = 1e-9; /* a rate that falls by less does not fall */

/* -- drift of the arms from each other ------------------------------------------------------------------------------- */
constexpr double LAG = 0.02; /* lag that an arm may have [s] */
constexpr double LARGEST_SLOPE = 0.02; /* a drift grows by no more than this share of the arms' way */
constexpr int FEW_SAMPLES = 4; /* fewer samples tell nothing of the noise */

/* -- forces from the servos ------------------------------------------------------------------------------------------ */
constexpr double STRUCTURE = 2e-9; /* compliance of what servos do not model [m/N]; 1 rad counts as 1 m */
constexpr double TURN_LENGTH = 0.3; /* 1 rad of turning counts as this many metres where directions are compared */
constexpr double LET_GO = 0.5; /* a force that held the object lets it go below this share of its limit */
constexpr double SERVO_PEAK = 0.05; /* an acceleration is remembered for this time [s] */
constexpr double HASTE_FILTER = 0.03; /* accelerations are filtered: a single step of arms that relax is none [s] */
constexpr double SOFTEST = 0.05; /* servos count as no softer than this share of what they are told to be */

/* -- forces from the sensors ----------------------------------------------------------------------------------------- */
constexpr double LONGEST_LAG = 0.15; /* servos and sensors answer no later than this [s] */
constexpr double LOOK_EVERY = 0.1; /* time between two looks at the compliances, which change with the configuration [s] */
constexpr int MOST_RELAXING = 64; /* arms whose forces are relaxed, at most */

/* -- sizes of the memory --------------------------------------------------------------------------------------------- */
constexpr int MOST_NODES = 1024; /* that the look-ahead keeps */
constexpr int MOST_TRAVELS = 32; /* ends of steps that are kept for the trail until it is read */
constexpr int MOST_JOINTS = 64; /* of an arm */
constexpr int MOST_SHARING = 8; /* arms of one group, which share joints, */
constexpr int MOST_GROUP_JOINTS = 64; /* and joints of all of them */
constexpr int SEGMENT = 29; /* numbers of a segment, see ObjectPath.packed */
constexpr int SHIFT = 8; /* numbers of a shift of the path, see unshifted */
constexpr int GRASP_PIECE = 53; /* numbers of a piece of a tool's motion on the object, see GraspMotion.packed */

#endif
