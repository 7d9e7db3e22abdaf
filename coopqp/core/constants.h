/* Constants that several files of the core read. Those of one file stand in it; those that Python reads, too, in
 * constants.py, of which layout.h is made. */

#ifndef COOPQP_CONSTANTS_H
#define COOPQP_CONSTANTS_H

constexpr double LIMIT_TOLERANCE = 1e-9; /* velocities within this of a limit are admissible, and clipped [rad/s or m/s] */
constexpr double APPROACH_TIME = 0.05; /* an edge is approached no faster than its room over this time [s], */
constexpr double APPROACH_STEPS = 5.0; /* and over this many steps */
constexpr double FASTEST_JOINT = 1e9; /* stands for the speed of a joint without velocity limit [rad/s or m/s] */
constexpr double JUST_BEFORE = 1e-10; /* the twist before a corner is taken this much earlier [s] */
constexpr int NEWTON_STEPS_AT_START = 1000; /* Newton steps that a reset may take */
constexpr double LET_GO = 0.5; /* a force that held the object lets it go below this share of its limit */
constexpr int FEW_SAMPLES = 4; /* fewer samples tell nothing of the noise */
constexpr double LARGEST_SLOPE = 0.02; /* a drift grows by no more than this share of the arms' way */
constexpr double SERVO_PEAK = 0.05; /* an acceleration is remembered for this time [s] */
constexpr double HASTE_FILTER = 0.03; /* accelerations are filtered: a single step of arms that relax is none [s] */
constexpr double SOFTEST = 0.05; /* servos count as no softer than this share of what they are told to be */
constexpr int MOST_SHARED = 6; /* a group with more joints that are shared is not inverted arm by arm */
constexpr int MOST_KINKS = 64; /* clocks at which the twist of a user's path was found to jump, that are kept */

#endif
