/* The memory of a controller: structs, and the fields of the three blocks that each Core owns in one piece.
 *
 * A struct is trivially copyable, and its numbers come first; made as T() all of it is zero, to the last bit. CONFIG never changes along a path; STATE is all that one step
 * hands to the next, so a copy of it is a copy of the controller; WORK is scratch. Vectors of joints have one number per
 * joint [rad or m]; twists are [linear; angular], of the object and in its reference frame unless another is named. */

#ifndef COOPQP_MEMORY_H
#define COOPQP_MEMORY_H

#include <type_traits>

#include "constants.h"

#define LISTED(name) name,

/* How a command was found: nominal, at a slower rate on the path, by the QP. */
#define OUTCOMES(NAME) NAME(NOMINAL) NAME(RATE_SEARCH) NAME(QP)
enum Outcome { OUTCOMES(LISTED) };

/* Members of LimitKind in Python, in their order. */
#define LIMIT_KINDS(NAME) \
    NAME(NONE) NAME(POSITION) NAME(VELOCITY) NAME(ACCELERATION) NAME(SINGULARITY) NAME(REACH) NAME(PATH_END) \
    NAME(OUT_OF_STEP) NAME(CONSTRAINT) NAME(OVERRIDE) NAME(PATH_JUMP)
enum LimitKind { LIMIT_KINDS(LISTED) };

/* Members of Status in Python, in their order. */
#define STATUSES(NAME) \
    NAME(TRACKING) NAME(SLOWED) NAME(BLOCKED) NAME(HOLDING) NAME(FAULTED) NAME(PAUSED) NAME(OFF_PATH)
enum Status { STATUSES(LISTED) };

/* Why a step holds or slows down; decoding.py has a sentence of each. With a reason come an index, of an arm from
 * OUT_OF_STEP_BY on, and two numbers a and b. */
#define REASONS(NAME) \
    NAME(NO_REASON) NAME(BAD_DT) NAME(NOT_FINITE) NAME(OFF_CIRCLE) NAME(JUMPED) NAME(CHAIN_APART) NAME(CHAIN_PARTED) \
    NAME(OUT_OF_STEP_BY) NAME(WAS_OUT_OF_STEP) NAME(STALLED) NAME(ALL_STALLED) NAME(FORCE) NAME(HANGS_BEHIND) \
    NAME(PATH_FAILED) NAME(PATH_JUMPS) NAME(LOOK_AHEAD_FAILED) NAME(CONSTRAINT_FAILED) NAME(OFF_SERVOS) NAME(TOUCHING) \
    NAME(OFF_LAG) NAME(FORCE_GROWS) NAME(OFF_WAY) NAME(UNSOLVED)
enum Reason { REASONS(LISTED) };

/* -- settings ---------------------------------------------------------------------------------------------------------- */

/* Settings of a path: QPOptions, PostureOptions, SupervisionOptions and PreviewOptions by their names, and what follows
 * from them. */
struct Options {
    double nominal_dt;          /* length of a step [s] */
    double grasp_gain;          /* of the grasp corrections [1/s], */
    double path_gain;           /* and of the path correction [1/s] */
    double correction_speed;    /* corrections are no faster than this [m/s], */
    double correction_spin;     /* and this [rad/s] */
    double measurement_time;    /* time constant of the filter of the measured object error [s] */
    double recovery_unit;       /* unit of the slack by which a joint outside its limits is not led back [rad/s or m/s], */
    double relax_unit;          /* of the slack of a further row that gives way, */
    double part_unit;           /* of the twists by which the chain parts [m/s], */
    double calm_unit;           /* and of self-motion where it does */
    double rise;                /* largest rise of the rate where the object looks ahead [1/s] */
    double blocked_rate;        /* an object that is slower than this share of its full rate is blocked */
    double override_slope;          /* pace at which the rate follows the override [1/s] */
    double off_path_distance;   /* an object further from its path is off it [m], */
    double off_path_angle;      /* or turned from it by more [rad] */
    double posture_gain;        /* of the way to the posture's target [1/s], */
    double centring;            /* of the way to the middle of a joint's limits [1/s], */
    double manipulability;      /* and of the gradient of the manipulability */
    double cell;                /* longest interval between grid points [s of the clock] */
    double joint_step;          /* a joint moves by no more between two of them [rad or m], */
    double slope_step;          /* and its slope changes by no more than this share of the largest */
    double shortest;            /* intervals are not halved below this [s of the clock] */
    double curvature_share;     /* share of the accelerations that q'' may take at the full rate */
    double doubt;               /* share e of the known changes of q'' by which it may change between grid points */
    double slope_cap;           /* largest planned change of the rate [1/s] */
    double room;                /* largest entry of `plan_room` [rad or m] */
    double singular_rate;       /* rate that a singularity leaves, below which it is one */
    double slow_from;           /* an arm this far out of step slows the object [m]; negative: none does */
    double hold_from;           /* and holds it from here on [m] */
    double drift_limit;              /* drift of an arm that does not count, at most [m] */
    double noise_margin;        /* standard deviations of the noise that do not count */
    double recovery_time;       /* time from rest to the full rate after a hold by the supervision [s]; 0: none */
    double fault_from;          /* an arm this far out of step is a fault [m] */
    double stall_share;         /* an arm that makes less of its commanded motion stands */
    double silent_time;         /* arms of which none follows are late for so long, then they have stopped [s] */
    double filter_time;         /* time constant of the filter of distances [s] */
    double dt_low, dt_high;     /* accepted lengths of a step over the nominal one */
    double joint_jump;          /* a joint measured further from its command is not believed [rad or m] */
    double force_limit;         /* force of a servo that holds the object [N] */
    double servo_delay;         /* delay of the servos [s] */
    double apart_hold;          /* commands that part the arms by more hold them [m] */
    int newton_steps;           /* of the look-ahead in a step */
    int stall_samples;          /* samples in which a stall is looked for; 0: none */
    int elbows;                 /* grid points of the motion of the elbows that comes with the path; 0: none does */
    bool shortcut;              /* the nominal command and the rate line search come before the QP */
    bool own_solver;            /* the core solves the QP, and not another solver */
    bool certified;             /* the constraints say where none of their rows binds */
    bool leaves_path;           /* arms may give way to constraints off the path */
    bool accelerates;           /* some joint has an acceleration limit */
    bool looks_ahead, caps_speed; /* the path is looked ahead along; speeds limit it there, and not in the step alone */
    bool watches_force;         /* the servos' stiffness is known */
};

/* What makes a bound of the rate: arm and joint are -1 where there is none; of a CONSTRAINT `joint` is its number. */
struct Cause {
    LimitKind kind;
    int arm, joint;
};

/* -- state ------------------------------------------------------------------------------------------------------------- */

/* Of the loop, beside its vectors. */
struct Loop {
    double clock, rate;         /* of the object along its path [s]; σ of the last step */
    double rate_slope;          /* change of the rate in the last step [1/s] */
    double last_dt;             /* length of the last step [s] */
    double fault_a, fault_b;    /* numbers of the fault */
    double path_distance;                /* of a user's path: distance of the object from it at the last step [m] */
    double override_rate;          /* speed override: largest rate that the operator asks for */
    double posture_blend;                /* share of the null-space reference that counts: it fades with a pause */
    double quiet_slack;         /* Σ reach |x - centre| below which no further row binds; negative: not known */
    double quiet_approach;      /* pace at which rows let distances fall [1/s] */
    double quiet_ahead_slack;         /* as quiet_slack, of grid points ahead */
    double status_age;            /* for how long `said` outlasts what a step alone would say [s] */
    Reason fault;               /* the object stopped for it; NO_REASON: for none */
    int fault_index;              /* index of the fault */
    Status status;                /* status of the last step */
    int path_lost;              /* a user's path: 0 is known, 1 has failed in this step, 2 has been found again */
    bool first_step;                 /* no step has been made since the start */
    bool has_predicted;         /* `predicted` and `foreseen` count */
    bool has_drift;               /* a measurement was taken: `drift` counts */
    bool corrects;            /* the last step led the object towards its path, by the twist `correcting` */
    bool paused;                 /* the operator pauses the object */
    bool started;               /* a step was made since the start */
    bool has_mismatch;              /* `mismatch` is not corrected yet */
    bool chain_held;            /* commands that part the arms held the last step */
    bool has_asked_shift;           /* the grasps were asked to shift since the last step, by `asked_shift` */
};

/* Ends of steps that are kept for the trail until it is read. */
struct Travels {
    int stride, left, count;    /* every so many steps, 0: none; steps until the next; how many are kept */
};

/* Of the supervision, beside its vectors. */
struct Watch {
    double noise_samples;             /* how many samples the noise is averaged over */
    double rate_cap;          /* cap of the rate that it left in the last step */
    double silence;             /* for how long no arm follows [s] */
    double drift_speed;         /* filtered speed of the joints [rad/s or m/s] */
    double drift_since;         /* time since the filter of the drift ran [s] */
    double drift_variance, drift_lag_covariance, lag_variance; /* of drift [m²] and lag [s²] */
    double rest_time;                /* for how long all joints rest [s] */
    double behind_gap, behind_pull;           /* how far the arm `behind` hangs behind [m]; force by which the others pull it [N] */
    double lag_low, lag_high;   /* bounds of the servos' lag [s] */
    double lag_acceleration;           /* acceleration of the object, filtered and remembered [m/s²] */
    double lag_noise;           /* noise in its deviation [m] */
    double lag_time;           /* for how long the lag is watched [s]; 0: not yet */
    double lag_softness;            /* deviation that the lag left unexplained at the start [m] */
    int cap_arm;              /* the arm that made the cap, or -1 */
    int far_samples;            /* samples in a row in which an arm was out of step as far as a fault */
    int past_count, past_head;  /* samples in `history`, and where the next goes */
    int behind;                 /* the arm that hangs behind its command, or -1 */
    bool force_holds;               /* the arms hold until they press less */
    bool has_seen;              /* `seen` counts, */
    bool has_commanded;         /* `commanded` does, */
    bool drift_started;         /* and `drift_last` */
    bool lag_suspected;          /* no lag explains where the object is */
};

/* What growth looks for where an interval was too long: a jump of a user's path, of its twist, of the path beside that. */
enum Seeking { NOT_SEEKING, JUMPS, KINKS_OF_TWIST, BESIDE_A_KINK };

/* Of the look-ahead, beside its vectors: grid points lie in a ring. */
struct Ahead {
    double free_until;          /* the full rate is known to be admissible up to this clock [s], */
    double grow_from;            /* and the next grid point is begun at this one */
    double trial_span;            /* interval before the grid point that is tried [s of the clock] */
    double blocked_at;           /* clock at which constraint `beyond` allows no rate [s] */
    double seek_from, seek_to;  /* clocks between which a jump is sought [s], */
    double seek_whole;          /* and the change between them [m or m/s] */
    double kink_at;                /* clock at which the twist jumps [s] */
    double jump_at, jump_by;    /* clock at which the path jumps [s], and by how much [m]; 0: it does not; < 0: it is too steep */
    double steep_by, steep_at;  /* the same of a change that may be a jump */
    int head, count;            /* place of the first grid point in the ring; how many are known */
    int settled;                  /* of how many K is known for good */
    int fresh;                  /* how many are known since K was last found */
    int kept;                   /* places in the ring behind them that are in use */
    int passing;                    /* tentative ones on the way past a singularity */
    int trial_steps;              /* Newton steps at the one that is tried */
    int blocked_by;                 /* 1 + the constraint that allows no rate beyond, or 0 */
    int kink_count;                  /* clocks in `kinks` */
    Seeking seeking;
    bool jump_sought, closing_in;    /* a jump was sought before the present interval's end; the search is between two clocks */
    bool complete;              /* nothing comes after the last one */
    bool ends_in_stop;                  /* the cap of the last step comes from a stop */
    bool growing;               /* a grid point is being tried */
    bool blind;                 /* the arms cannot follow the path: nothing is known ahead */
};

/* A grid point of the look-ahead beside its vectors. */
struct Node {
    double clock, span;         /* its clock, and the interval before it [s] */
    double cap, uncapped;       /* largest z = σ² there; without a bound at 1 */
    double fastest;             /* largest slope of a joint [rad/s or m/s] */
    double slope_excess;              /* most by which a slope changed beyond what it may since the one before [rad/s or m/s] */
    double fall, rise;          /* largest fall and rise of the rate that constraints allow [1/s] */
    double square;              /* K, the largest z from which the object can go on */
    double line_square, line_from, line_to, line_slope; /* K follows K ahead from `since`, where it was found, to `until` along a line of slope `gain` */
    Cause limit, cause;         /* of the cap; of K */
    bool inside;                /* all joints are inside their limits */
    bool corner;                /* the twist jumps: the slopes are those after it */
    bool stops;                 /* K comes from a stop */
};

/* -- scratch ----------------------------------------------------------------------------------------------------------- */

/* Of the step that is proposed, beside its vectors. */
struct Proposal {
    double dt;                  /* length of the step [s] */
    double cap, span;           /* largest rate; share of the clock over which ν is the mean [s] */
    double watch_cap;           /* largest rate by the supervision */
    double reason_a, reason_b;  /* numbers of the reason */
    double new_rate;            /* σ of the answer, */
    double grasp_share, path_share; /* its shares of the corrections, */
    double parting;             /* and the speed at which its chain parts [m/s] */
    double binding_side;        /* 1 at an upper bound, -1 at a lower one */
    double brake_keep;                /* share of the rate, or of the last correction, that is left where all joints brake */
    double apart;               /* how far the commands part the arms, at the grasps [m] */
    double mismatch_left;       /* share of the mismatch that is left */
    double closed_share;              /* share of the grasps' errors that full grasp corrections take away */
    double last_span, last_saved; /* of the answer before: its span, and by how much more it was than the answer took [s] */
    Cause cause;                /* of the cap */
    Reason reason;
    int reason_index;             /* index of the reason */
    Outcome outcome;
    int binding_row;            /* row that makes the rate, a joint or a further row; -1: none */
    int bindings, rows;         /* limits of the QP's answer; further rows */
    int iterations;             /* of the QP */
    int outside;                /* joints outside their limits */
    int paces;                  /* answers over another share of the clock */
    bool has_measured, has_errors; /* `measured` counts; `errors` are known */
    bool hold, is_fault;          /* the object holds; it is a fault */
    bool late;                  /* the joints have to brake now to stop inside their limits */
    bool relaxed, asked_solver;       /* soft rows may give way; another solver was asked */
    bool braked;                /* no QP had an answer: the arms brake */
    bool corrections_made;                  /* the corrections are what the answer makes */
    bool chain_holds, mismatched; /* commands that part the arms hold; a mismatch is left */
};

/* The record of a step, before its vectors q, velocity, q_next, off_path, and four numbers per binding limit: kind,
 * arm, joint, constraint, each -1 if it does not apply. */
struct Record {
    double dt, clock, clock_next, rate; /* see ControlStep */
    double reason_a, reason_b;
    double grasp_share, path_share, parting;
    double away, turned;        /* how far the object is off its path [m], [rad]; 0 within the bounds */
    double apart;               /* how far the commands part the arms [m] */
    Status status;
    Reason reason;
    int reason_index;
    Outcome outcome;
    int iterations, bindings;
    bool measured, braked;      /* measurements have a share in that; the arms braked for want of an answer */
};

/* -- fields ------------------------------------------------------------------------------------------------------------ */

template <typename... T> constexpr bool COPIED = (std::is_trivially_copyable_v<T> && ...);
static_assert(COPIED<Options, Loop, Travels, Watch, Ahead, Node, Proposal, Record>);
#define NUMBERS(type) ((sizeof(type) + sizeof(double) - 1) / sizeof(double))

/* FIELD(type, name, how many numbers), in n arms, nv joints, nq numbers of a configuration, the unknowns of the condensed
 * QP without slacks, samples of the past, further rows, and in `scratch` of the largest QP. Types are of views.h. */
#define CONFIG_FIELDS(FIELD) \
    FIELD(Vector, arm_group, n)              /* group of an arm that shares joints, or -1 */ \
    FIELD(double *, link_R, 9 * nv)          /* placement of a joint in the one before at position 0: rotation, */ \
    FIELD(double *, link_p, 3 * nv)          /* and origin [m] */ \
    FIELD(Vector, pitch, nv)                 /* way along its axis [m/rad]: 0 turns, infinity slides */ \
    FIELD(Vector, continuous, nv)            /* 1: its position in a configuration is (cos, sin) */ \
    FIELD(Vector, q_index, nv)               /* where it stands in a configuration */ \
    FIELD(Pose *, object, 12 * n)            /* the object on the last joint of each arm, as its grasp is now, */ \
    FIELD(Points, tool_p, 3 * n)             /* and the tool's origin there [m] */ \
    FIELD(Vector, scale, nv)                 /* unit of a joint's velocity in norms */ \
    FIELD(Pose *, places, 12 * n)            /* `object` without a shift of the grasps */ \
    FIELD(Twists, shares, 6 * n)             /* W_k, shares of the arms in the common error */ \
    FIELD(Vector, holding, n)                /* 1: the arm holds the object */ \
    FIELD(Vector, low, nv)                   /* position limits, */ \
    FIELD(Vector, high, nv) \
    FIELD(Vector, speed, nv)                 /* velocity limits [rad/s or m/s], */ \
    FIELD(Vector, acceleration, nv)          /* and acceleration limits [rad/s² or m/s²]; infinite: none */ \
    FIELD(double *, unit, unknowns)          /* of each unknown of the QP: its cost is its square in this */ \
    FIELD(Square, at_grasps, 36)             /* Lᵀ: displacements of the object as lengths at the grasps */ \
    FIELD(Points, levers, 3 * n)             /* places of the grasps from their centre, over the largest */ \
    FIELD(Vector, softness, nv)              /* of the servos, 1 / Kp */ \
    FIELD(Vector, posture_cap, nv)           /* largest velocity of the null-space reference */ \
    FIELD(Vector, posture_bounded, nv)       /* 1: the joint has both position limits, */ \
    FIELD(Vector, posture_middle, nv)        /* with this middle */ \
    FIELD(Vector, plan_speed, nv)            /* limits that are planned with: velocity, */ \
    FIELD(Vector, plan_acceleration, nv)     /* acceleration, */ \
    FIELD(Vector, plan_jump, nv)             /* change of the velocity in a step, */ \
    FIELD(Vector, plan_room, nv)             /* and way to the end of an arm's reach [rad or m] */ \
    FIELD(Vector, slope_change, nv)          /* change of a slope between grid points that counts for nothing */ \
    FIELD(Vector, most_move, nv)             /* way of a joint in a step, if neither speed nor acceleration is limited */ \
    FIELD(Options *, options, NUMBERS(Options))

#define STATE_FIELDS(FIELD) \
    FIELD(Loop *, loop, NUMBERS(Loop)) \
    FIELD(Vector, positions, nv)             /* as commanded, */ \
    FIELD(Vector, velocity, nv)              /* in the last step, */ \
    FIELD(Vector, before, nv)                /* and in the one before */ \
    FIELD(Vector, near_x, nv)                /* positions close by, of each joint, */ \
    FIELD(Vector, near_sin, nv)              /* their sines */ \
    FIELD(Vector, near_cos, nv)              /* and cosines */ \
    FIELD(Twists, predicted, 6 * n)          /* errors e_k that the last step left, as it is linearised [m, rad] */ \
    FIELD(Twists, foreseen, 6 * n)           /* defects b_k that it foresaw [m/s, rad/s] */ \
    FIELD(Twists, mismatch, 6 * n)           /* parting of the arms that was asked for, and is still to be corrected */ \
    FIELD(Twists, grasp_shift, 6 * n)        /* by which the grasps have given way */ \
    FIELD(Twists, asked_shift, 6 * n)        /* of it what was asked for since the last step, less the mean */ \
    FIELD(Twist, drift, 6)                   /* measured less commanded object error, filtered */ \
    FIELD(Twist, latched, 6)                 /* what other arms that hold leave of it, so that it stays continuous */ \
    FIELD(double *, changed_at, 1)           /* changes of contact up to this clock are taken [s] */ \
    FIELD(Twist, correcting, 6)              /* twist of the last step towards the path */ \
    FIELD(Vector, posture_target, nv) \
    FIELD(Vector, quiet_centre, nv)          /* about these positions no further row binds, */ \
    FIELD(Vector, quiet_reach, nv)           /* with these weights of the joints' ways; */ \
    FIELD(Vector, quiet_ahead_centre, nv)    /* the same of grid points ahead */ \
    FIELD(Vector, quiet_ahead_reach, nv) \
    FIELD(Watch *, watch, NUMBERS(Watch)) \
    FIELD(Twists, deviation, 6 * n)          /* measured from commanded, lengths at the grasps, filtered [m] */ \
    FIELD(Twists, away, 6 * n)               /* the same of the last sample, */ \
    FIELD(Twists, away_step, 6 * n)          /* and its change */ \
    FIELD(Vector, noise, n)                  /* mean square of second differences [m²] */ \
    FIELD(Vector, stalled, n)                /* 1: the arm has stalled, */ \
    FIELD(Vector, widest, n)                 /* since when it was this far from its command [rad or m] */ \
    FIELD(Vector, lost, n)                   /* samples in a row that it repeats */ \
    FIELD(Vector, held, n)                   /* `holding` at the last sample */ \
    FIELD(Vector, seen, nq)                  /* the last sample */ \
    FIELD(double *, history, 2 * nv * past)  /* ring of samples: positions as measured, then as commanded */ \
    FIELD(Twists, slow_drift, 6 * n)         /* b, the drift of each arm [m], */ \
    FIELD(Twists, lag, 6 * n)                /* and c, its lag [m per unit of joint speed] */ \
    FIELD(Twists, apart, 6 * n)              /* distances from the others, filtered [m] */ \
    FIELD(Vector, drift_last, nv)            /* positions when the drift was last found */ \
    FIELD(Twist, lag_base, 6)                /* deviation of the object at rest [m], */ \
    FIELD(Twist, lag_told, 6)                /* its commanded velocity, filtered [m/s], */ \
    FIELD(Twist, lag_way, 6)                 /* and the direction of that */ \
    FIELD(Vector, deflection, nv)            /* of the servos, filtered [rad or m] */ \
    FIELD(Vector, way, nv)                   /* velocities of the last motion [rad/s or m/s] */ \
    FIELD(Vector, commanded, nv)             /* positions at the last sample */ \
    FIELD(Vector, forces, n)                 /* of the servos at the grasps [N], */ \
    FIELD(Vector, slow_forces, n)            /* and filtered */ \
    FIELD(Ahead *, ahead, NUMBERS(Ahead)) \
    FIELD(Pose *, ahead_object, 12 * n)      /* `object` and `grasp_shift` that the look-ahead counts with */ \
    FIELD(Twists, ahead_shift, 6 * n) \
    FIELD(double *, kinks, MOST_KINKS)       /* clocks at which the twist of a user's path jumps [s] */ \
    FIELD(Pose *, seek_low, 12)              /* pose, or twist, of a user's path at the ends of the search */ \
    FIELD(Pose *, seek_high, 12) \
    FIELD(Vector, told_velocity, nv)         /* commanded velocity, filtered */ \
    FIELD(Node *, nodes, NUMBERS(Node) * MOST_NODES) /* the ring, and its vectors: */ \
    FIELD(double *, node_positions, nv * MOST_NODES) \
    FIELD(double *, node_slope, nv * MOST_NODES)     /* q' [rad or m per s of the clock], */ \
    FIELD(double *, node_curvature, nv * MOST_NODES) /* q'' over the interval before, */ \
    FIELD(double *, node_bending, nv * MOST_NODES)   /* its change per second, */ \
    FIELD(double *, node_edges, nv * MOST_NODES)     /* and the joints' way to the end of each arm's reach */ \
    FIELD(Travels *, travels, NUMBERS(Travels)) \
    FIELD(double *, travelled, (2 + 2 * nv) * MOST_TRAVELS) /* clock, rate, positions, velocities */

#define WORK_FIELDS(FIELD) \
    FIELD(Proposal *, proposal, NUMBERS(Proposal)) \
    FIELD(Pose *, own_pose, 12)              /* what a user's path answers, or in its first numbers the twist */ \
    FIELD(Pose *, carried, 12 * n)           /* O_k, the object as each arm carries it, as commanded */ \
    FIELD(Twists, jacobian, 6 * nv)          /* J: twists of the object about its origin, in world axes */ \
    FIELD(Pose *, pose, 12)                  /* T, the object's reference pose */ \
    FIELD(Twist, along, 6)                   /* ν, twist of the path a second of its clock; of each tool: own_along */ \
    FIELD(Twist, path, 6)                    /* c_p, the path correction */ \
    FIELD(Twist, whole_along, 6)             /* the wanted motion, of which few joints follow a part */ \
    FIELD(Twist, whole_path, 6) \
    FIELD(Twists, whole_own, 6 * n) \
    FIELD(Twists, whole_grasp, 6 * n) \
    FIELD(Twists, whole_offsets, 6 * n) \
    FIELD(double *, ranges, 36 * n)          /* orthonormal twists that an arm with few joints can make */ \
    FIELD(Square, admitted, 36)              /* twists that all arms can follow */ \
    FIELD(Twist, measured, 6)                /* object error that the path correction sees */ \
    FIELD(Vector, measured_positions, nv) \
    FIELD(Pose *, measured_carried, 12 * n) \
    FIELD(Twists, measured_away, 6 * n)      /* measured from commanded */ \
    FIELD(Twists, measured_moved, 6 * n)     /* the same less the shifts of the grasps */ \
    FIELD(double *, posture_work, 7 * nv) \
    FIELD(Twist, common, 6)                  /* ē, the common error */ \
    FIELD(Twists, errors, 6 * n)             /* e_k */ \
    FIELD(Twists, grasp, 6 * n)              /* c_k, the grasp corrections */ \
    FIELD(Twists, offsets, 6 * n)            /* b_k, what makes up for linearisation and shifts */ \
    FIELD(Twists, left_over, 6 * n)          /* b_k less what the last step foresaw */ \
    FIELD(Twists, own_along, 6 * n)          /* ν of each tool, */ \
    FIELD(Twists, own_world, 6 * n)          /* and in world axes */ \
    FIELD(Vector, own_way, n)                /* 1: the arm follows a way of its joints, */ \
    FIELD(Vector, ahead_own_way, n)          /* and at the grid point that is tried */ \
    FIELD(Twists, foresees, 6 * n)           /* defects that this step foresees, */ \
    FIELD(Twists, made, 6 * n)               /* twists that it makes, */ \
    FIELD(Twists, best_offsets, 6 * n)       /* and the best of several linearisations */ \
    FIELD(Twists, best_foresees, 6 * n) \
    FIELD(Vector, best_guess, nv) \
    FIELD(Vector, null_along, nv)            /* null-space reference: per unit of rate, */ \
    FIELD(Vector, null_offset, nv)           /* and beside it */ \
    FIELD(Vector, command, nv)               /* v */ \
    FIELD(Vector, stand_in, nv)              /* velocity before a first step */ \
    FIELD(Vector, guess, nv)                 /* velocity about which the step is linearised, */ \
    FIELD(Vector, first_guess, nv)           /* and the first answer */ \
    FIELD(Vector, along_velocity, nv)        /* what a unit of rate adds to v */ \
    FIELD(Twist, off_path, 6)                /* s, twist off the path */ \
    FIELD(Vector, lower, nv)                 /* the box of v */ \
    FIELD(Vector, upper, nv) \
    FIELD(Vector, recovery, nv)              /* velocities that lead joints back, */ \
    FIELD(Vector, outside, nv)               /* 1: that are outside their limits */ \
    FIELD(Vector, pull, nv)                  /* multipliers of the box */ \
    FIELD(double *, further, nv * rows)      /* further rows: lower <= G v <= upper, */ \
    FIELD(double *, further_lower, rows) \
    FIELD(double *, further_upper, rows) \
    FIELD(double *, further_soft, rows)      /* how far each gives way; 0: it never does, */ \
    FIELD(double *, further_owner, rows)     /* and its label; below 0 of those that brake all arms together */ \
    FIELD(double *, base, nv + rows)         /* rows of the condensed QP: base + columns x */ \
    FIELD(double *, columns, (nv + rows) * (unknowns + 6 * n)) \
    FIELD(double *, x, unknowns + 6 * n + nv + rows) \
    FIELD(double *, bindings, 4 * (nv + rows)) /* row and side of each limit of the answer */ \
    FIELD(Record *, record, NUMBERS(Record) + 2 * nq + nv + 6 + 4 * (nv + rows)) \
    FIELD(double *, sketch, 24 * n + 9 * nv) /* of a Newton step ahead */ \
    FIELD(Vector, least_pivot, n)            /* smallest pivot of each arm's latest inverse */ \
    FIELD(double *, lines, 3 * (4 * nv + 4)) /* of a program of two variables */ \
    FIELD(Vector, evading_positions, nv)     /* a grid point that is tried or expected, */ \
    FIELD(Vector, evading_slope, nv)         /* and q' there */ \
    FIELD(double *, scratch, scratch)

#endif
