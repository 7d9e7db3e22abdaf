"""The core's memory, listed once: for Python, and for the header.

Scalars are members of structs of doubles. Every field is an array of float64, or of such structs, in one of three
blocks: ``CONFIG`` never changes, ``STATE`` is all that one step hands to the next (a copy of it is a copy of the
controller), ``WORK`` is scratch. Sizes are written in n arms, nv joints, nq numbers of a configuration, the unknowns of
the condensed QP without slacks, samples of the past, further rows, and in ``scratch`` of the largest QP.
"""

from __future__ import annotations

import ctypes
from typing import Any

#: The structs by name, in the order of the header.
STRUCTS: dict[str, Any] = {}


def _struct(name: str, members: str) -> Any:
    """A struct of doubles, or of structs: ``member:Struct``. Made ``from_buffer`` it is a view of an array."""
    pairs = (member.partition(":") for member in members.split())
    fields = [(member, STRUCTS[kind] if kind else ctypes.c_double) for member, _, kind in pairs]
    STRUCTS[name] = type(name, (ctypes.Structure,), {"__slots__": (), "_fields_": fields})
    return STRUCTS[name]


#: What makes a cap: codes of :data:`KINDS`; arm and joint are −1 where there is none.
Cause = _struct("Cause", "kind arm joint")
Options = _struct(
    "Options",
    "nominal_dt grasp_gain path_gain correction_speed correction_spin measurement_time shortcut own_solver certified "
    "leaves_path accelerates recovery_unit relax_unit part_unit calm_unit "
    "rise blocked_rate rein_slope off_path_distance off_path_angle "
    "posture_gain centring manipulability posture_share looks_ahead caps_speed cell joint_step slope_step shortest "
    "curvature_share doubt slope_cap room singular_rate newton_steps slow_from hold_from let_in noise_margin "
    "recovery_time fault_from stall_samples stall_share silent_time filter_time dt_low dt_high joint_jump "
    "watches_force force_limit servo_delay apart_hold elbows",
)
# Of the state: the loop, the ends of steps that it keeps for the trail, the watch with the drift filter and the forces,
# the look-ahead.
Loop = _struct(
    "Loop",
    "clock rate last_dt has_predicted first drifted correcting fault fault_arm fault_a fault_b path_lost away "
    "overridden pause ease quiet_slack quiet_approach quiet_ahead started mismatch chain_held said outdated "
    "shift_asked rate_slope",
)
Travels = _struct("Travels", "stride left count")
Watch = _struct(
    "Watch",
    "samples watch_rate watch_arm silence pressed has_seen past_count past_head far_samples drift_speed drift_since "
    "drift_started var_drift covariance var_lag rest has_commanded behind gap pull "
    "lag_low lag_high lag_haste lag_noise lag_begun lag_suspects lag_soft",
)
Ahead = _struct(
    "Ahead",
    "head count known fresh complete ends free_until begin_at growing try_span iteration way beyond beyond_at kept "
    "sought blind kinks seeking closing_in seek_from seek_to seek_whole kink jump_at jump_by steep_by steep_at",
)
#: A knot beside its vectors: what limits its own cap, and what causes the largest square of the rate there.
Knot = _struct(
    "Knot",
    "clock span cap uncapped fastest change inside corner fall rise limit:Cause square cause:Cause stops found since "
    "until gain",
)
#: The proposal of a step. The reason comes with an arm (or an index) and two numbers.
Proposal = _struct(
    "Proposal",
    "dt cap span has_measured cause:Cause watch_cap hold faults reason reason_arm reason_a reason_b outcome new_rate "
    "binding_row binding_side grasp_share path_share parting braked iterations outside relaxed placed late keep "
    "bindings rows apart chain_holds mismatch_left mismatched has_errors closes made solved paces "
    "last_span last_saved",
)
#: The record of a step, before its vectors q, velocity, q_next, off_path, and four numbers per binding limit: kind,
#: arm, joint, constraint, each −1 if it does not apply.
Record = _struct(
    "Record",
    "dt clock clock_next rate status reason reason_arm reason_a reason_b grasp_share path_share parting outcome "
    "iterations bindings away turned measured apart braked",
)
#: Scalars of the relaxation of forces: settings, then state; see minding.h for the arrays behind them.
Minding = _struct(
    "Minding",
    "wrench_filter dead_band relax_time drift_time ramp_time wrench_silence most_speed most_spin most_reach most_turn "
    "wait move_below pressed_below force_slows force_holds has_palms squeeze most_squeeze size stiffer relax_ease "
    "saturated stage since stepped age asked force_cap last_rate last_speed at_end friction_used pressed_with needed "
    "sensor_fault sensor_arm sensor_amount allowed why why_arm rigid weight_x weight_y weight_z haste suspected "
    "servo_samples servo_noise corrects start_size way_done load_mass contact_limit load_haste touches pushed "
    "sharpest asked_dt reference_dt contact_late goes_on back_speed back_owed back_from backs load_speed look_at",
)
#: How many numbers a struct has.
SIZES = {name: ctypes.sizeof(kind) // 8 for name, kind in STRUCTS.items()}
#: Stages of a run with forces, in this order.
STAGES = ("CHECKING", "PRESSING", "RELAXING", "MOVING")
#: Readings of the sensors in a step.
HEARING = ("HEARD", "MISSED", "SILENT")
#: Faults of a sensor: silent for ``sensor_amount`` seconds; ``sensor_amount`` newtons from the servos' estimate.
SENSORS = ("SENSORS_FINE", "SENSOR_SILENT", "SENSOR_WRONG")
#: Why the object may move at ``allowed`` only; NOTHING_MORE: the operator asks for no more.
WHYS = ("NOTHING_MORE", "BY_SENSOR", "BY_REACH", "BY_STAGE", "BY_FRICTION", "BY_FORCE", "BY_CONTACT", "BY_RELEASE")
#: Members of Status, in the order of their codes.
STATUSES = ("TRACKING", "SLOWED", "BLOCKED", "HOLDING", "FAULTED", "PAUSED", "OFF_PATH")

#: ASK: rows may bind that the constraints have not given yet.
OUTCOMES = ("NOMINAL", "RAY", "QP", "ASK")
#: Members of LimitKind, in the order of their codes; 0 is none.
KINDS = (
    "NONE", "POSITION", "VELOCITY", "ACCELERATION", "SINGULARITY", "REACH", "PATH_END", "OUT_OF_STEP", "CONSTRAINT",
    "OVERRIDE", "PATH_JUMP",
)  # fmt: skip
REASONS = (
    "NO_REASON", "BAD_DT", "NOT_FINITE", "OFF_CIRCLE", "JUMPED", "CHAIN_APART", "CHAIN_PARTED", "OUT_OF_STEP_BY",
    "WAS_OUT_OF_STEP", "STALLED", "ALL_STALLED", "FORCE", "HANGS_BEHIND", "PATH_FAILED", "PATH_JUMPS",
    "LOOK_AHEAD_FAILED", "CONSTRAINT_FAILED", "OFF_SERVOS", "TOUCHING", "OFF_LAG", "FORCE_GROWS", "OFF_WAY", "UNSOLVED",
)  # fmt: skip


def _fields(text: str) -> tuple[tuple[str, str], ...]:
    """Names and sizes of fields."""
    return tuple((name, size) for name, _, size in (field.strip().partition(" ") for field in text.split(";")))


#: The fields of each block: name and size, in C++. A size that begins with a struct is of a field of such structs.
CONFIG = _fields(
    "arm_group n; link_R 9 * nv; link_p 3 * nv; pitch nv; continuous nv; q_index nv; "
    "object 12 * n; tool_p 3 * n; scale nv; places 12 * n; shares 6 * n; holding n; "
    "low nv; high nv; speed nv; acceleration nv; unit unknowns; at_grasps 36; levers 3 * n; softness nv; "
    "posture_cap nv; posture_bounded nv; posture_middle nv; "
    "plan_speed nv; plan_acceleration nv; plan_jump nv; plan_room nv; slope_change nv; most_move nv; options Options"
)
STATE = _fields(
    "loop Loop; positions nv; velocity nv; before nv; predicted 6 * n; foreseen 6 * n; mismatch 6 * n; "
    "grasp_shift 6 * n; asked_shift 6 * n; drift 6; latched 6; changed_at 1; correcting 6; "
    "posture_target nv; quiet_centre nv; quiet_reach nv; "
    "quiet_ahead_centre nv; quiet_ahead_reach nv; watch Watch; deviation 6 * n; away 6 * n; away_step 6 * n; noise n; "
    "stalled n; widest n; lost n; held n; seen nq; history 2 * nv * past; slow_drift 6 * n; lag 6 * n; apart 6 * n; "
    "drift_last nv; lag_base 6; lag_told 6; lag_way 6; deflection nv; way nv; commanded nv; forces n; "
    "slow_forces n; ahead Ahead; ahead_object 12 * n; ahead_shift 6 * n; "
    "kinks MOST_KINKS; seek_low 12; seek_high 12; told_velocity nv; knots Knot * MOST_KNOTS; "
    "knot_positions nv * MOST_KNOTS; knot_slope nv * MOST_KNOTS; knot_curvature nv * MOST_KNOTS; "
    "knot_bending nv * MOST_KNOTS; knot_edges nv * MOST_KNOTS; "
    "travels Travels; travelled (2 + 2 * nv) * MOST_TRAVELS"
)
WORK = _fields(
    "proposal Proposal; own_pose 12; near_x nv; near_sin nv; near_cos nv; carried 12 * n; jacobian 6 * nv; pose 12; "
    "along 6; path 6; whole_along 6; whole_path 6; whole_own 6 * n; whole_grasp 6 * n; whole_offsets 6 * n; "
    "ranges 36 * n; admitted 36; measured 6; measured_positions nv; measured_carried 12 * n; measured_away 6 * n; "
    "measured_moved 6 * n; posture_work 7 * nv; common 6; errors 6 * n; grasp 6 * n; offsets 6 * n; left_over 6 * n; "
    "own_along 6 * n; own_world 6 * n; own_way n; ahead_own_way n; "
    "foresees 6 * n; made 6 * n; best_offsets 6 * n; best_foresees 6 * n; best_guess nv; null_along nv; "
    "null_offset nv; command nv; stand_in nv; guess nv; first_guess nv; along_velocity nv; off_path 6; lower nv; "
    "upper nv; recovery nv; outside nv; pull nv; further nv * rows; further_lower rows; further_upper rows; "
    "further_soft rows; further_owner rows; base nv + rows; columns (nv + rows) * (unknowns + 6 * n); "
    "x unknowns + 6 * n + nv + rows; "
    "bindings 4 * (nv + rows); record Record + 2 * nq + nv + 6 + 4 * (nv + rows); sketch 24 * n + 9 * nv; "
    "least_pivot n; lines 3 * (4 * nv + 4); evading_positions nv; evading_slope nv; scratch scratch"
)
BLOCKS = {"CONFIG": CONFIG, "STATE": STATE, "WORK": WORK}


def members(struct: Any) -> set[str]:
    """Names of the members of a struct."""
    return {name for name, _ in struct._fields_}


#: Enumerations of the header, and their members in the order of their codes.
ENUMS = {
    "Outcome": OUTCOMES, "LimitKind": KINDS, "Reason": REASONS, "Status": STATUSES, "Stage": STAGES,
    "Hearing": HEARING, "SensorFault": SENSORS, "Why": WHYS,
}  # fmt: skip
