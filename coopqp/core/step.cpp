/* One step: observe the measurement, propose a command, commit it. See "The order of the attempts" in docs/derivations.md. */

#include "functions.h"
#include "force_relaxation.h"

constexpr int MOST_TIGHTENINGS = 3; /* answers with rows that the one before broke by the bend of distances */
constexpr double LEAST_PACE = 1e-3; /* the increment along the path is the mean over this share of a step at least */
constexpr int MOST_PACES = 4; /* answers over another share of the clock, where a step takes another one than expected, */
constexpr double SAME_PACE = 1e-6; /* which differs by more than this of itself, */
constexpr double OFF_PACE = 1e-10; /* and leads further off the path than this [m] */
/* An increment that grows by less of itself with its share leads to a path that rests */
constexpr double PACE_STANDS = 1e-9;
constexpr double NEGLIGIBLE = 1e-10; /* square of an off-path twist that needs no braking distance [m²/s², rad²/s²] */
/* The first step has settled when its change of velocity moves the joints by less [rad²] */
constexpr double SETTLED = 1e-13;
/* An object that comes to a stop for good counts as blocked from this many times the rate on */
constexpr double ARRIVING = 10.0;
/* A blocked object counts as blocked until it has gone on by this way of its clock [s], */
constexpr double STILL_BLOCKED = 1e-5;
/* A slowed one, where nothing is known ahead, as slowed for so long at its full rate [s] */
constexpr double STILL_SLOWED = 0.05;
constexpr double RESTING_SPEED = 1e-3; /* a paused object that leaves its path faster does not rest yet [m/s], */
constexpr double RESTING_SPIN = 1e-2; /* or by this [rad/s] */
constexpr int EXTRA_AT_START = 3; /* linearisations of a first or long step beyond the others */
constexpr double LONG_STEP = 0.03; /* a step that moves a joint further is linearised again [rad or m] */
constexpr double BENT_STEP = 1e-6; /* so is one whose linearisation errs by more [rad²] */
constexpr double CIRCLE_TOLERANCE = 0.05; /* how far (cos, sin) of a continuous joint may be from the unit circle */
constexpr double RETREAT_ROOM = 0.02; /* an object that has met something goes back by no more than this [m], */
constexpr double RETREAT_TIME = 0.2; /* and what it goes in this time [s] */

static void refuse(Core *c, Reason reason, int index, double a) {
    Proposal *p = c->proposal;
    p->watch_cap = 0.0, p->hold = true;
    p->reason = reason, p->reason_index = index, p->reason_a = a, p->reason_b = 0.0;
}

/* -- observe --------------------------------------------------------------------------------------------------------- */

/* Positions (near the commanded ones) of a measured configuration; 0 if it is not believed. */
static int believe(Core *c, const double *q, double *positions) {
    double worst = 0.0;
    int joint = 0;
    for (int i = 0; i < c->nq; i++)
        if (!isfinite(q[i])) {
            refuse(c, NOT_FINITE, i, q[i]);
            return 0;
        }
    for (int j = 0; j < c->joints; j++) {
        const double *at = q + (int)c->q_index[j], x = c->positions[j];
        positions[j] = at[0];
        if (c->continuous[j] != 0.0) {
            const double radius = sqrt(at[0] * at[0] + at[1] * at[1]);
            if (!(fabs(radius - 1.0) <= CIRCLE_TOLERANCE)) {
                refuse(c, OFF_CIRCLE, (int)c->q_index[j], radius);
                return 0;
            }
            positions[j] = x + wrapped(c, j, atan2(at[1], at[0]) - x);
        }
        if (fabs(positions[j] - x) > worst) worst = fabs(positions[j] - x), joint = j;
    }
    if (worst > c->options->joint_jump) {
        refuse(c, JUMPED, joint, worst);
        return 0;
    }
    return 1;
}

/* Where the arms hold the object, by their shares in the common error: the reference pose where the path has none. */
static void hold_here(Core *c) {
    const Pose &first = c->carried[0];
    Vector6 mean = Vector6::Zero(), twist;
    for (int k = 0; k < c->arms; k++)
        if (log6(between(first, c->carried[k]), twist)) mean += c->shares.col(k).cwiseProduct(twist);
    *c->pose = compose(first, exp6(mean));
}

/* Time constant of the filter of the measured object error while h of N arms hold: T (N/h)². The path correction takes up to
 * K / (2 ω (1 + ω² T²)) from the damping ratio of a mode at ω in which the object swings on its arms, with the gain K. Fewer arms
 * hold it less stiffly, with ω² smaller by h/N: for ω T > 1/3 the share that is taken does not grow then. */
static double measurement_time(const Core *c) {
    const double fewer = c->arms / c->holding.sum();
    return fewer * fewer * c->options->measurement_time;
}

/* The object's error for the path correction: the commanded one plus the further measured error, which fades in slowly.
 * While the arms hold it is 0: the measured error of an arm that does not move would lead the others away without end. */
static int fade_in_measurement(Core *c, const double *positions, const double *q) {
    Proposal *p = c->proposal;
    const double h = p->dt;
    const double corrects = c->relaxation ? c->relaxation->correction_share : 1.0; /* arms that relax forces relax first */
    if (!positions && !((c->loop->has_drift || corrects < 1.0) && !p->hold)) {
        c->measured.setZero();
        return p->hold;
    }
    if (!p->has_errors) return 0;
    const Vector6 commanded = common_error(c, c->errors);
    if (positions) {
        Twists &away = c->measured_away;
        carry(c, positions, c->measured_carried);
        if (!view_errors(c, c->measured_carried, away)) return 0;
        const Vector6 found = common_error(c, away);
        away -= c->errors;
        watch_sample(c, positions, q, away, h);
        c->drift += h / (h + measurement_time(c)) * (found - commanded + c->latched - c->drift);
        c->loop->has_drift = true;
    }
    c->measured = (p->hold ? 0.0 : corrects * p->watch_cap) * (commanded + c->drift);
    return 1;
}

/* An object that touches something goes back, unless something else holds it. Returns whether it does. */
static int retreat(Core *c) {
    const Proposal *p = c->proposal;
    ForceRelaxation *m = c->relaxation;
    if (!m || m->retreats_at == 0.0 || m->sensor_fault != SENSORS_FINE) return 0;
    const double gain = min_of(c->options->path_gain, 1.0 / p->dt);
    if ((p->hold && p->reason != TOUCHING) || !(gain > 0.0) || !p->has_errors) return 0;
    const Vector3 way = c->pose->R.transpose() * relaxation_of(c->arms, m).push->back;
    const double far = way.dot(common_error(c, c->errors).head<3>());
    if (isnan(m->retreat_from)) m->retreat_from = far;
    const double room = RETREAT_ROOM + RETREAT_TIME * m->retreat_speed - (far - m->retreat_from);
    const double speed = minimum(m->retreats_at, maximum(room, 0.0) / p->dt);
    c->measured = both(-speed / gain * way, Vector3::Zero());
    return 1;
}

static double pose_distance(const Pose &A, const Pose &B) {
    const double trace = A.R.cwiseProduct(B.R).sum();
    return (B.p - A.p).norm() + TURN_LENGTH * acos(clamp(0.5 * (trace - 1.0), -1.0, 1.0));
}

/* The reference pose; of a user's own path also how far it jumps, in this step or since the last. 0 if the path fails. */
static int ask_for_path(Core *c, double h, double *far) {
    Pose later;
    double *away = &c->loop->path_distance;
    if (!path_pose(c, c->loop->clock, *c->pose)) return 0;
    if (c->path_numbers[2] != 0.0) return 1;
    if (!path_pose(c, c->loop->clock + h, later)) return 0;
    const double now = pose_distance(*c->pose, c->carried[0]); /* of the object as the first arm carries it */
    *far = max_of(pose_distance(*c->pose, later), now - *away);
    if (*far <= FASTEST_PATH * h) *away = now;
    return 1;
}

/* Take one sample: q as measured (nullptr where commands are followed exactly), the step's length (NaN: nominal). */
static void observe(Core *c, const double *q, const double *dt) {
    Proposal *p = c->proposal;
    double *positions = c->measured_positions;
    const double nominal = c->options->nominal_dt;
    *p = Proposal();
    p->dt = nominal, p->watch_cap = 1.0, p->reason_index = p->binding_row = p->cause.arm = p->cause.joint = -1.0;
    if (dt) {
        if (*dt >= c->options->dt_low * nominal && *dt <= c->options->dt_high * nominal)
            p->dt = *dt;
        else
            refuse(c, BAD_DT, -1, *dt);
    }
    if (q && !believe(c, q, positions)) q = nullptr;
    keep_sines(c, c->positions, 0.5 * CLOSE_BY);
    c->contact_due = grasps_move(c) && contact_changes(c, c->loop->clock);
    if (c->contact_due) c->was_drifted = c->loop->has_drift, c->made = c->shares;
    if (grasps_move(c)) place_grasps(c, c->loop->clock, c->grasp_shift), take_contact(c, c->loop->clock);
    carry(c, c->positions, c->carried);
    const int was_lost = c->loop->path_lost == 1.0;
    c->loop->path_lost = was_lost ? 2.0 : 0.0; /* 2: found again */
    double far = 0.0;
    const int known = ask_for_path(c, p->dt, &far);
    if (!known || far > FASTEST_PATH * p->dt) {
        c->loop->path_lost = 1.0;
        c->loop->has_predicted = false; /* that was from another reference */
        q = nullptr;
        hold_here(c);
        refuse(c, known ? PATH_JUMPS : PATH_FAILED, -1, c->loop->clock);
        p->reason_b = far;
    }
    if (c->loop->fault != NO_REASON) {
        refuse(c, c->loop->fault, c->loop->fault_index, c->loop->fault_a);
        p->reason_b = c->loop->fault_b, p->is_fault = true;
    }
    p->has_errors = view_errors(c, c->carried, c->errors);
    if (p->has_errors) watch_chain(c);
    if (grasps_move(c)) watch_ways(c, c->loop->clock);
    p->has_measured = fade_in_measurement(c, q ? positions : nullptr, q);
    if (retreat(c)) p->has_measured = true;
}

/* Take a change of contact that is due, or hold where an arm that attaches is not where it grasps. The object's measured error
 * goes on as it was under the shares before it, which `made` has: Σ (s⁻ − s) (e − ē) stays. */
static void change_contact(Core *c) {
    Proposal *p = c->proposal;
    const bool measured = p->has_measured && c->loop->has_drift;
    if (measured && c->was_drifted) {
        const Vector6 kept = (c->made - c->shares).cwiseProduct(c->measured_away).rowwise().sum();
        const Vector6 change = p->dt / (p->dt + measurement_time(c)) * kept;
        c->latched += kept, c->drift += change;
        c->measured += (p->hold ? 0.0 : p->watch_cap) * change;
    }
    if (!measured) std::copy(c->carried, c->carried + c->arms, c->measured_carried);
    const bool held = !(p->watch_cap > 0.0);
    if (c->ask(c, ASK_CONTACT) > 0) c->changed_at[0] = c->loop->clock + SAME_CLOCK;
    else if (!held) c->measured.setZero();
}

/* -- propose --------------------------------------------------------------------------------------------------------- */

static void cap_rate(Core *c, double cap, LimitKind kind, int arm) {
    Proposal *p = c->proposal;
    if (!(cap < p->cap)) return;
    p->cap = cap, p->cause.kind = kind, p->cause.arm = arm, p->cause.joint = -1.0;
}

/* The largest rate that the operator asks for. */
static double rate_asked(const Core *c) { return c->loop->paused ? 0.0 : c->loop->override_rate; }

/* The fastest fall of the rate where nothing is known ahead [1/s]: all joints brake together, on a straight path. */
static double blind_brake(const Core *c) {
    double tightest = 0.0;
    for (int j = 0; j < c->joints; j++)
        tightest = max_of(tightest, fabs(c->velocity[j]) / (BRAKING_SHARE * c->acceleration[j]));
    return tightest > 0.0 ? c->loop->rate / tightest : INFINITY;
}

static bool moves(const Core *c) { return (c->velocity.array() != 0.0).any(); }

/* The largest rate by the override, reached as fast as the joints can follow. */
static double overridden_rate(const Core *c, double h) {
    const double share = rate_asked(c), rate = c->loop->rate;
    double fall = c->options->override_slope;
    if (share >= rate || !moves(c)) return share;
    if (accelerates(c) && sees(c) && c->ahead->count > 0)
        fall = preview_brake(c, c->loop->clock, h, rate);
    else if (accelerates(c))
        fall = blind_brake(c);
    return max_of(share, rate - fall * h);
}

/* The null-space motion stops while the object is paused, and goes on after it. */
static void blend_posture(Core *c, double h) {
    double *posture_blend = &c->loop->posture_blend;
    const double change = c->options->override_slope * h;
    if (rate_asked(c) < c->options->blocked_rate)
        *posture_blend = max_of(*posture_blend - change, 0.0);
    else if (*posture_blend < 1.0)
        *posture_blend = min_of(*posture_blend + change, 1.0);
}

/* A rate that a step will not exceed, whatever the path ahead allows. */
static double most_rate(const Core *c, double h) {
    const double rate = c->loop->rate, most = min_of(c->proposal->watch_cap, max_of(rate_asked(c), rate));
    const double risen = rate + c->options->rise * h;
    return rate < 1.0 && risen < 1.0 - RATE_ROUNDING ? min_of(most, risen) : most;
}

/* The fastest rate that the path ahead, the supervision and the last rate allow, and its cause. */
static void find_cap(Core *c) {
    Proposal *p = c->proposal;
    const double h = p->dt, rate = c->loop->rate;
    p->cap = 1.0, p->late = false, p->brake_keep = 1.0;
    if (c->loop->path_lost == 2.0) {
        c->loop->path_lost = 0.0;
        if (c->looks_ahead) preview_reset(c, c->loop->clock, 1); /* the known horizon is void after the path has failed */
    }
    if (sees(c)) p->cap = preview_cap(c, c->loop->clock, h, most_rate(c, h));
    /* A correction that can end within a step need not brake ahead: it would stop and start in turn beside a limit. */
    if (accelerates(c) && (!sees(c) || (c->loop->corrects && !stops_at_once(c, h)))) {
        int joint = -1;
        p->brake_keep = brake_share(c, h, &joint);
        p->late = p->brake_keep < 1.0;
        if (p->late && !sees(c) && p->brake_keep * rate < p->cap) {
            cap_rate(c, p->brake_keep * rate, POSITION, arm_of(c, joint));
            p->cause.joint = joint;
        }
    }
    const int by_arm = p->reason >= OUT_OF_STEP_BY && p->reason_index >= 0; /* else it is an index, or nothing */
    cap_rate(c, p->watch_cap, by_arm ? OUT_OF_STEP : NONE, by_arm ? p->reason_index : -1);
    if (rate < 1.0 && c->options->looks_ahead) {
        int joint = -1;
        const double most = sees(c) ? preview_rise(c, c->loop->clock, &joint) : INFINITY;
        const double rise = min_of(c->options->rise, most);
        if (rate + rise * h < p->cap - RATE_ROUNDING) {
            const int by_joint = joint >= 0 && !(most > c->options->rise);
            cap_rate(c, rate + rise * h, by_joint ? ACCELERATION : NONE, -1);
            if (by_joint) p->cause.joint = joint;
        }
    }
    cap_rate(c, overridden_rate(c, h), OVERRIDE, -1);
}

/* Limit the error that the path correction sees, so that the correction is `keep` of the last one. */
static void brake_correction(Core *c, double keep) {
    if (!c->proposal->has_measured && c->proposal->has_errors) c->measured = common_error(c, c->errors);
    for (int part = 0; part < 6; part += 3) {
        const double now = c->options->path_gain * c->measured.segment<3>(part).norm();
        const double allowed = c->loop->corrects ? keep * c->correcting.segment<3>(part).norm() : 0.0;
        if (now > allowed) c->measured.segment<3>(part) *= allowed / now;
    }
    c->proposal->has_measured = true;
}

/* Joint velocities asked for in the null-space: along the elbows or the preview, or by the posture's rule. */
static void find_null_reference(Core *c) {
    if (sees(c) && led(c)) {
        elbow_velocity(c, c->loop->clock, c->proposal->span, c->positions, c->null_along);
        c->null_offset.setZero();
    } else if (sees(c)) {
        preview_reference(c, c->loop->clock, c->null_offset, c->null_along);
        c->null_offset = c->options->posture_gain * (c->null_offset - c->positions);
    } else {
        c->null_along.setZero();
        posture_velocity(c, c->positions, c->null_offset);
    }
    if (c->loop->posture_blend < 1.0) c->null_offset *= c->loop->posture_blend;
    if (c->proposal->hold) c->null_offset.setZero();
}

/* Mean twists of the object in a step of velocities v, as each arm carries it, in the world frame about the reference
 * origin: log(O(q + h v) O(q)⁻¹) / h. */
static int twists_made(Core *c, const Vector &v, double h) {
    Vector ahead(c->scratch, c->joints, 1);
    Pose *after = reinterpret_cast<Pose *>(c->scratch + c->joints);
    ahead = c->positions + h * v;
    carry(c, ahead, after);
    for (int k = 0; k < c->arms; k++) {
        const Pose &O = c->carried[k];
        const Matrix3 D = after[k].R * O.R.transpose();
        if (!log6({D, after[k].p - c->pose->p - D * (O.p - c->pose->p)}, c->made.col(k))) return 0;
    }
    c->made /= h;
    return 1;
}

/* b_k = A_k v less the twists made, of arm k, in the reference object frame. */
static Vector6 defect(const Core *c, int k, const Vector &v) {
    if (follows_way(c, k)) return Vector6::Zero();
    const ArmJoints &a = joints_of(c, k);
    double columns[6 * MOST_JOINTS], room[MOST_JOINTS];
    const OfArm J(side_by_side(a, c->jacobian, 6, columns), 6, a.n);
    Vector6 missed = J.lazyProduct(Given(side_by_side(a, v, 1, room), a.n)) - c->made.col(k);
    for (int i = 0; i < a.shared; i++) missed += v[a.joint[i]] * c->jacobian.col(a.joint[i]);
    return turned_back(c->pose->R, missed);
}

/* By how much the step that the command makes misses the twists that it was to make [m, rad]. */
static double missed(const Core *c, double h) {
    double most = 0.0;
    for (int k = 0; k < c->arms; k++)
        most = max_of(most, (defect(c, k, c->command) - c->foresees.col(k)).cwiseAbs().maxCoeff());
    return most * h;
}

/* Largest speed [m/s] at which an arm leaves the common motion of an answer. */
static double parting_speed(const Core *c) {
    const Proposal *p = c->proposal;
    Twists made(c->scratch, 6, c->arms);
    double most = 0.0;
    twists_of(c, c->command, made);
    for (int k = 0; k < c->arms; k++) {
        if (follows_way(c, k)) continue;
        const Vector6 along = grasps_move(c) ? Vector6(c->own_along.col(k)) : Vector6(c->along);
        const Vector6 common = c->off_path + p->new_rate * along + p->path_share * c->path +
                               p->grasp_share * c->grasp.col(k) + c->offsets.col(k);
        most = max_of(most, (turned_back(c->pose->R, made.col(k)) - common).head<3>().norm());
    }
    return most;
}

/* Whether the QP has an answer; by another solver if that is asked for. The iterations come from this core's own. */
static bool solves(Core *c, double cap, int relax) {
    Proposal *p = c->proposal;
    p->relaxed = relax;
    if (!c->options->own_solver) {
        p->asked_solver = true;
        return c->solve && c->solve(c, relax);
    }
    const int iterations = solve_condensed(c, cap, relax);
    if (iterations < 0) return false;
    p->iterations = iterations;
    return true;
}

/* The QP; where its chain cannot be kept, that whose chain may part; where that has no answer either, all arms brake. */
static Outcome settle_qp(Core *c, double cap) {
    Proposal *p = c->proposal;
    box(c, p->dt);
    const int outside = lead_back(c, p->dt);
    int soft = 0;
    p->outside = outside;
    for (int r = 0; r < c->further_rows; r++) soft |= c->further_soft[r] != 0.0;
    if (outside >= 0 && condense(c, cap, false)) {
        bool found = solves(c, cap, 0) || (soft && solves(c, cap, 1));
        if (found && c->redundant && shrink_units(c, p->dt)) found = solves(c, cap, p->relaxed);
        if (found && read_answer(c, cap)) return QP;
        if (condense(c, cap, true) && solves(c, cap, 1) && read_answer(c, cap)) {
            p->parting = parting_speed(c);
            return QP;
        }
    }
    brake_now(c);
    return QP;
}

/* The ranked answer at one linearisation: nominal, else the fastest rate on the path, else the QP. */
static Outcome settle(Core *c, double cap) {
    Proposal *p = c->proposal;
    const double h = p->dt;
    p->new_rate = cap, p->binding_row = -1, p->bindings = 0;
    p->grasp_share = p->path_share = 1.0, p->corrections_made = !some_have_few(c), p->parting = 0.0, p->braked = false;
    c->off_path.setZero();
    if (c->options->shortcut && nominal_command(c, cap)) {
        if (well_inside(c, h) && further_admissible(c, LIMIT_TOLERANCE)) return NOMINAL;
        if (box(c, h)) {
            if (admissible(c) && further_admissible(c, LIMIT_TOLERANCE)) {
                clip(c, INFINITY);
                return NOMINAL;
            }
            if (search_rate(c, cap)) return RATE_SEARCH;
            p->new_rate = cap, p->binding_row = -1;
        }
    }
    return settle_qp(c, cap);
}

/* Linearise at the middle of the way that joint velocities make; the middle is in `scratch`. */
static void linearise_about(Core *c, const Vector &v) {
    Vector middle(c->scratch, c->joints, 1);
    middle = c->positions + 0.5 * c->proposal->dt * v;
    carry_and_linearise(c, middle, c->pose->p, nullptr, c->jacobian);
}

/* Whether one linearisation is not enough for the command. */
static int long_step(const Core *c) {
    const double h = c->proposal->dt, change = (c->command - c->guess).cwiseAbs().maxCoeff();
    const double fastest = c->command.cwiseAbs().maxCoeff();
    return fastest * h > LONG_STEP || change * h * fastest * h > BENT_STEP;
}

/* Linearise about the answer's own way until it settles, `least` times at least, and keep the answer that misses least:
 * near singularities a further one may miss more. */
static Outcome settle_again(Core *c, double cap, Outcome outcome, int least) {
    const double h = c->proposal->dt;
    const bool few = some_have_few(c);
    double smallest = INFINITY;
    for (int done = 0;; done++) {
        if (!twists_made(c, c->command, h)) return outcome;
        const double miss = missed(c, h);
        const int best = miss < smallest;
        const int last = done == (int)EXTRA_AT_START || (done >= least && miss <= SETTLED);
        if (best) {
            smallest = miss, c->best_guess = c->guess, c->best_foresees = c->foresees;
            c->best_offsets = few ? c->whole_offsets : c->offsets;
        }
        if (last && best) return outcome;
        c->guess = last ? c->best_guess : c->command;
        linearise_about(c, c->guess);
        if (last) {
            c->offsets = c->best_offsets, c->foresees = c->best_foresees;
            if (few) c->whole_offsets = c->offsets, follow_part(c);
            return settle(c, cap);
        }
        for (int k = 0; k < c->arms; k++) c->foresees.col(k) = defect(c, k, c->guess);
        c->offsets = c->left_over + c->foresees;
        if (few) c->whole_offsets = c->offsets, follow_part(c);
        outcome = settle(c, cap);
    }
}

/* No look-ahead covers the motion: none has one, or arms that give way have left their path. */
static int brakes_together(const Core *c) {
    return !sees(c) || gives_way(c);
}

/* The ranked answer under the cap and the further rows, along the path as it is looked at; returns an outcome. */
static Outcome answer_along(Core *c) {
    Proposal *p = c->proposal;
    const int first = c->loop->first_step;
    c->further_rows = c->given_rows;
    if (brakes_together(c)) brake_together(c);
    p->rows = c->further_rows;
    c->guess = 2.0 * c->velocity - c->before;
    linearise_about(c, c->guess);
    if (some_have_few(c)) follow_part(c);
    Outcome outcome = settle(c, p->cap);
    const int again = long_step(c);
    if (first) c->first_guess = c->command;
    if (first || again) outcome = settle_again(c, p->cap, outcome, again);
    /* The velocities at the start and the middle of the first step serve as the velocities of two steps. */
    if (first) c->stand_in = 2.0 * c->first_guess - c->command;
    p->outcome = outcome;
    return outcome;
}

/* ν, of the object and of each tool, over a share of the clock from now on; 0 if the path fails. */
static int look_along(Core *c, double span) {
    const double clock = c->loop->clock;
    c->proposal->span = span;
    return path_increment(c, clock, span, *c->pose, c->along) && (!grasps_move(c) || grasp_increments(c, clock, span));
}

/* Motion that is asked for in the null-space over that share. */
static void reference_along(Core *c) {
    if (c->redundant) find_null_reference(c);
    else if (any_follows_way(c)) c->null_along.setZero(), c->null_offset.setZero();
    if (grasps_move(c)) reference_along_ways(c, c->loop->clock, c->proposal->span, c->proposal->dt);
}

/* The wanted motion over that share. */
static void want(Core *c) {
    reference_along(c);
    corrections(c, c->proposal->dt);
    if (c->few) keep_whole(c);
}

/* ν as it was looked at, and what it is now, in metres. */
struct Pace {
    double size = 0.0, along = 0.0, farthest = 0.0; /* square, product with the change, the largest change */

    void add(const Vector6 &before, const Vector6 &now) {
        Vector6 unit = Vector6::Ones();
        unit.tail<3>().setConstant(TURN_LENGTH);
        const Vector6 own = unit.cwiseProduct(before), change = unit.cwiseProduct(now - before);
        size += own.squaredNorm(), along += own.dot(change), farthest = maximum(farthest, change.norm());
    }
};

/* Whether the answer takes the object elsewhere than the path is after its share of the clock; then the path is looked at
 * over another one, for the next answer. ν is the mean over the share that was expected. Another share that was answered asks
 * for another mean: where the cap makes it, for that over the share itself, else for that over the share at which both will be
 * the same. */
static int look_at_pace(Core *c) {
    Proposal *p = c->proposal;
    const double h = p->dt, rest = c->duration - c->loop->clock, rate = p->new_rate, span = p->span;
    double way = min_of(h * max_of(rate, LEAST_PACE), rest);
    if (p->paces == MOST_PACES || c->loop->path_lost != 0.0) return 0;
    if (!(rate > 0.0 && fabs(way - span) > SAME_PACE * way)) return 0;
    const bool few = some_have_few(c);
    const Vector6 before = c->along;
    Twists own(c->scratch, 6, c->arms);
    if (grasps_move(c)) own = c->own_along;
    Pace pace;
    int known = look_along(c, way);
    if (!grasps_move(c)) pace.add(few ? c->whole_along : before, c->along);
    else for (int k = 0; k < c->arms; k++) pace.add((few ? c->whole_own : own).col(k), c->own_along.col(k));
    const bool other = known && rate * h * pace.farthest > OFF_PACE;
    const double saved = span - way;
    if (other && rate < p->cap - RATE_TOLERANCE) {
        if (p->paces == 0) { /* to first order, where the path is as far on as the answer leads; more leads as far if it rests */
            const double missed = way * pace.along, slope = pace.size - missed / saved;
            if (slope > PACE_STANDS * pace.size) way -= missed / slope;
            else if (saved < 0.0) way = h;
        } else { /* by the last two answers */
            const double slope = (saved - p->last_saved) / (span - p->last_span);
            if (slope > 0.0) way = span - saved / slope;
        }
        known = look_along(c, min_of(clamp(way, h * LEAST_PACE, h), rest));
    }
    if (!(other && known)) {
        c->along = before, p->span = span;
        if (grasps_move(c)) c->own_along = own;
        return 0;
    }
    p->paces++, p->last_span = span, p->last_saved = saved;
    want(c);
    return 1;
}

/* The ranked answer, over the share of the clock that it takes. */
static Outcome answer(Core *c) {
    Outcome outcome = answer_along(c);
    for (c->proposal->paces = 0; look_at_pace(c);) outcome = answer_along(c);
    return outcome;
}

/* Find the command under a cap; returns an outcome. Nothing of the state changes. */
static Outcome propose_capped(Core *c) {
    Proposal *p = c->proposal;
    const double h = p->dt, clock = c->loop->clock, rest = c->duration - clock;
    if (p->late) brake_correction(c, p->brake_keep);
    if (rest < h * p->cap) p->cap = rest / h; /* the last step ends at the end */
    /* The mean along the path has to see a corner that the step may reach. */
    const int corner = sees(c) && next_breakpoint(c, clock) <= clock + h * p->cap;
    /* Else at the rate that is expected: it goes on to change as it did. */
    const double expected = c->loop->rate + c->loop->rate_slope * h;
    const double pace = corner ? p->cap : min_of(p->cap, max_of(expected, 0.0));
    const double span = min_of(h * max_of(pace, LEAST_PACE), rest);
    if (c->loop->path_lost != 0.0 || !look_along(c, span)) {
        c->along.setZero(), c->own_along.setZero();
        if (p->watch_cap > 0.0) refuse(c, PATH_FAILED, -1, clock);
        p->cap = 0.0, p->span = span;
    }
    want(c);
    p->rows = c->given_rows;
    return answer(c);
}

/* Find the command under the rows that there are; returns an outcome. */
static Outcome propose_with_rows(Core *c) {
    c->proposal->cause.kind = NONE;
    find_cap(c);
    return propose_capped(c);
}

/* The outcome with all further rows: those that are certified are asked for where they may bind, and tightened if the command
 * breaks their constraints. */
static Outcome settle_with_rows(Core *c) {
    const bool certified = c->options->certified, held = c->proposal->hold;
    Outcome outcome = NOMINAL;
    c->given_rows = 0;
    if (certified || !c->asks_rows) outcome = propose_with_rows(c);
    if (!c->asks_rows) return outcome;
    if (certified && quiet_step(c)) {
        if (!c->node_asked) c->ask(c, ASK_SURVEY); /* not every piece of work on bodies in one step */
        return outcome;
    }
    if (certified && c->ask(c, ASK_CLEAR) == 1) return outcome;
    c->given_rows = (int)c->ask(c, ASK_ROWS);
    const bool failed = !held && c->proposal->hold;
    outcome = certified && !failed ? answer(c) : propose_with_rows(c);
    for (int i = 0; c->given_rows && i < MOST_TIGHTENINGS && c->ask(c, ASK_TIGHTER) > 0; i++) outcome = answer(c);
    return outcome;
}

/* Find the command for the observed sample; returns an outcome. Nothing of the state changes but the preview, which grows, and
 * who is known to hold the object. */
static Outcome propose(Core *c) {
    if (c->contact_due) change_contact(c);
    c->node_asked = c->surveyed = 0;
    return settle_with_rows(c);
}

/* The rate that a step from here would keep; its command stays in the proposal, and nobody commits it. */
static double try_step(Core *c) {
    observe(c, nullptr, nullptr);
    settle_with_rows(c);
    return c->proposal->braked ? 0.0 : min_of(c->proposal->cap, c->proposal->new_rate);
}

/* -- commit ---------------------------------------------------------------------------------------------------------- */

/* Entries of the record: what binds the step. Returns whether a position, an acceleration limit is among them. */
static void write_bindings(Core *c, double *entries, int *position, int *acceleration) {
    const Proposal *p = c->proposal;
    const int most = c->joints + c->rows;
    int count = 0;
    const int rows = p->outcome == RATE_SEARCH && p->binding_row >= 0 ? 1 : p->bindings;
    for (int i = 0; i < rows && count < most; i++, count++) {
        const int single = p->outcome == RATE_SEARCH, row = (int)(single ? p->binding_row : c->bindings[2 * i]);
        const double side = single ? p->binding_side : c->bindings[2 * i + 1];
        const int joint = row < c->joints;
        entries[4 * count] = joint ? kind_of(c, row, side, p->dt) : CONSTRAINT;
        entries[4 * count + 1] = -1.0;
        entries[4 * count + 2] = joint ? row : -1.0;
        entries[4 * count + 3] = joint ? -1.0 : c->further_owner[row - c->joints];
        if (!joint && c->further_owner[row - c->joints] < 0.0)
            name_brake(c, (int)(-1.0 - c->further_owner[row - c->joints]), entries + 4 * count);
    }
    if (!count && p->cause.kind != NONE) {
        const int own = p->cause.kind == CONSTRAINT;
        entries[0] = p->cause.kind, entries[1] = p->cause.arm;
        entries[own ? 2 : 3] = -1.0, entries[own ? 3 : 2] = p->cause.joint;
        count = 1;
    }
    *position = *acceleration = 0;
    for (int i = 0; i < count; i++) {
        *position |= entries[4 * i] == POSITION;
        *acceleration |= entries[4 * i] == ACCELERATION;
    }
    c->record->bindings = count;
}

static Status slow_status(const Core *c, double rate, int position, int acceleration) {
    const int rising = rate > c->loop->rate + RATE_ROUNDING, outside = any_outside(c);
    const int ends = position || (sees(c) && c->ahead->ends_in_stop);
    const int arriving = ends && !rising && !outside;
    if (rate >= c->options->blocked_rate * (arriving ? ARRIVING : 1.0)) return SLOWED;
    /* The bound on its rise, or a part of the path that is not yet seen, keeps the rate small without a limit. From rest
     * accelerations do: the rate then grows, or a joint is on its way back in. A rate that is small at a corner grows
     * again after it. */
    const double clock = c->loop->clock, dt = c->options->nominal_dt;
    if (sees(c) && !ends && rate > 0.0 && next_breakpoint(c, clock - dt) <= clock + dt) return SLOWED;
    return c->record->bindings == 0 || (acceleration && (rising || outside)) ? SLOWED : BLOCKED;
}

/* The status that a step alone would say, or that of the last step, which lasts a moment. */
static Status lasting(Core *c, Status found, double rate) {
    const double h = c->proposal->dt, last = c->loop->status;
    double more = 0.0, most = 0.0;
    if (last == BLOCKED && found == SLOWED && c->record->bindings > 0)
        more = rate * h, most = STILL_BLOCKED;
    else if (last == SLOWED && found == TRACKING && !sees(c))
        more = h, most = STILL_SLOWED;
    if (more > 0.0 && c->loop->status_age + more <= most) {
        c->loop->status_age += more;
        return last == BLOCKED ? BLOCKED : SLOWED;
    }
    if (last != BLOCKED || found != BLOCKED) c->loop->status_age = 0.0;
    return found;
}

/* How far the object is off its path [m], [rad], by the measurements; 0 within the options' bounds. */
static int off_its_path(const Core *c, double *distance, double *angle) {
    Vector6 e = common_error(c, c->errors);
    if (c->loop->has_drift) e += c->drift;
    const double far = c->options->off_path_distance, wide = c->options->off_path_angle, turn = e.tail<3>().norm();
    if (!(e.head<3>().norm() > far) && !(turn > wide)) return 0; /* the shift is at most as long as the twist's */
    const double shift = exp6(e).p.norm();
    *distance = shift > far ? shift : 0.0, *angle = turn > wide ? turn : 0.0;
    return *distance > 0.0 || *angle > 0.0;
}

/* Whether an object whose clock stands rests; its errors are corrected. */
static int rests(const Core *c) {
    return c->off_path.head<3>().norm() <= RESTING_SPEED && c->off_path.tail<3>().norm() <= RESTING_SPIN;
}

static void bind_override(Core *c, double *entries) {
    static const double by_override[4] = {OVERRIDE, -1.0, -1.0, -1.0};
    memcpy(entries, by_override, sizeof by_override);
    c->record->bindings = 1;
}

/* Set the start of the next step. */
static void move_on(Core *c, double rate, double clock_next) {
    const Proposal *p = c->proposal;
    const double h = p->dt;
    const Vector6 twist = p->path_share * c->path + c->off_path;
    for (int k = 0; k < c->arms; k++)
        c->predicted.col(k) = h * (p->grasp_share * c->grasp.col(k) + c->offsets.col(k) + twist);
    for (int k = 0; some_have_few(c) && k < c->arms; k++) /* the reference goes on along all of the path's twist */
        c->predicted.col(k) += h * rate * (grasps_move(c) ? Vector6(c->own_along.col(k) - c->whole_own.col(k)) : Vector6(c->along - c->whole_along));
    const Vector6 bend = bend_of_way(c->errors.col(0), c->predicted.col(0));
    for (int k = 0; k < c->arms; k++) c->predicted.col(k) += c->errors.col(k) + bend;
    if (p->outcome == QP || accelerates(c)) c->loop->corrects = twist.squaredNorm() > NEGLIGIBLE, c->correcting = twist;
    c->foreseen = c->foresees;
    c->before = c->loop->first_step ? c->stand_in : c->velocity;
    c->velocity = c->command;
    c->positions += h * c->command;
    c->loop->has_predicted = p->parting == 0.0 && !p->braked && c->loop->path_lost == 0.0;
    /* A start sets the rate, and where no acceleration is limited the first step may leave it by a jump: no slope. */
    const int jumped = c->loop->first_step && !accelerates(c);
    c->loop->rate_slope = jumped ? 0.0 : (rate - c->loop->rate) / h;
    c->loop->last_dt = h, c->loop->clock = clock_next, c->loop->rate = rate, c->loop->first_step = false;
}

static void write_configuration(const Core *c, double *q) {
    for (int j = 0; j < c->joints; j++) {
        double *at = q + (int)c->q_index[j];
        at[0] = c->positions[j];
        if (c->continuous[j] != 0.0) at[0] = cos(c->positions[j]), at[1] = sin(c->positions[j]);
    }
}

/* Keep the end of every so many steps for the way back, until it is read: coopqp/control/operator/trail.py. */
static void keep_travelled(Core *c) {
    Travels *kept = c->travels;
    if (!(kept->stride > 0) || --kept->left > 0 || !(kept->count >= 0 && kept->count < MOST_TRAVELS)) return;
    kept->left = kept->stride;
    double *row = c->travelled + kept->count++ * (2 + 2 * c->joints);
    row[0] = c->loop->clock, row[1] = c->loop->rate;
    Vector(row + 2, c->joints, 1) = c->positions;
    Vector(row + 2 + c->joints, c->joints, 1) = c->velocity;
}

/* Move the state by the proposed command, and write the record. Returns the status. */
static Status commit(Core *c) {
    Proposal *p = c->proposal;
    Record *r = c->record;
    double *q = vectors_of(r), *velocity = q + c->nq, *q_next = velocity + c->joints, *off_path = q_next + c->nq;
    const double h = p->dt, clock = c->loop->clock, rate = clamp(p->new_rate, 0.0, 1.0);
    double clock_next = clock + rate * h;
    if (c->duration - clock_next < 1e-9 * c->duration) clock_next = c->duration;
    /* the last step needs the full rate */
    const double share = rate >= 1.0 || (clock_next >= c->duration && !p->hold) ? 1.0 : rate;
    Status status = TRACKING;
    int position, acceleration;
    write_bindings(c, off_path + 6, &position, &acceleration);
    if (share <= 1.0 - 1e-6) status = slow_status(c, share, position, acceleration);
    status = lasting(c, status, share);
    if (rate_asked(c) < c->options->blocked_rate && share < c->options->blocked_rate) {
        status = rests(c) ? PAUSED : SLOWED;
        if (r->bindings == 0) bind_override(c, off_path + 6);
    }
    r->away = r->turned = 0.0, r->measured = c->loop->has_drift;
    if (p->hold || p->braked)
        status = HOLDING;
    else if (off_its_path(c, &r->away, &r->turned))
        status = OFF_PATH;
    else if (status == PAUSED)
        bind_override(c, off_path + 6); /* before any other reason to stop */
    if (p->hold && p->is_fault) {
        status = FAULTED;
        if (c->loop->fault == NO_REASON)
            c->loop->fault = p->reason, c->loop->fault_index = p->reason_index, c->loop->fault_a = p->reason_a,
            c->loop->fault_b = p->reason_b;
    }
    if (status == TRACKING && p->outcome != QP) r->bindings = 0;
    const int stopped = status == SLOWED || status == BLOCKED;
    for (int i = 0; i < r->bindings && stopped && p->reason == NO_REASON; i++)
        if (off_path[6 + 4 * i] == PATH_JUMP && c->ahead->jump_by != 0.0)
            p->reason = PATH_JUMPS, p->reason_a = c->ahead->jump_at, p->reason_b = c->ahead->jump_by;
    if (p->braked && p->reason == NO_REASON) p->reason = UNSOLVED;
    r->braked = p->braked && !p->hold;
    c->loop->status = status;
    r->dt = h, r->clock = clock, r->clock_next = clock_next, r->rate = share, r->status = status;
    r->reason = p->reason, r->reason_index = p->reason_index, r->reason_a = p->reason_a, r->reason_b = p->reason_b;
    r->grasp_share = p->grasp_share, r->path_share = p->path_share, r->parting = p->parting;
    r->outcome = p->outcome, r->iterations = p->iterations, r->apart = p->apart;
    Twist(off_path, 6, 1) = c->off_path;
    Vector(velocity, c->joints, 1) = c->command;
    write_configuration(c, q);
    chain_watched(c);
    move_on(c, rate, clock_next);
    keep_travelled(c);
    blend_posture(c, h);
    write_configuration(c, q_next);
    return status;
}

/* -- starting -------------------------------------------------------------------------------------------------------- */

/* Start along a path at `clock`. */
static void start_path(Core *c, double clock, double rate) {
    c->loop->clock = clock, c->loop->first_step = true, c->loop->has_predicted = false;
    c->loop->rate = rate, c->loop->rate_slope = 0.0;
    keep_sines(c, c->positions, 0.0); /* so that a restart repeats to the last bit */
    c->loop->path_distance = INFINITY;
    c->loop->status = TRACKING;
    if (c->looks_ahead) preview_reset(c, clock, 0);
}

/* Start at rest at `positions`. */
static void start(Core *c, const double *positions) {
    const double override = c->loop->override_rate, pause = c->loop->paused; /* a start ends neither */
    *c->loop = Loop();
    c->loop->override_rate = override, c->loop->paused = pause;
    c->loop->posture_blend = rate_asked(c) < c->options->blocked_rate ? 0.0 : 1.0;
    c->positions = Given(positions, c->joints);
    c->velocity.setZero(), c->before.setZero();
    c->drift.setZero(), c->latched.setZero(), c->correcting.setZero();
    c->loop->last_dt = c->options->nominal_dt;
    watch_reset(c);
}
