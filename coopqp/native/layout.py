"""The core's memory, listed once: for the definition in Python, and for the header.

Every field is an array of float64 in one of three blocks: ``CONFIG`` never changes, ``STATE`` is all that one step
hands to the next (a copy of it is a copy of the controller), ``WORK`` is scratch. Sizes are written in the symbols of
:func:`sizes`.
"""

from __future__ import annotations

import functools

from coopqp.native.constants import MOST_KINKS, MOST_KNOTS

OPTIONS = (
    "NOMINAL_DT", "GRASP_GAIN", "PATH_GAIN", "CORRECTION_SPEED", "CORRECTION_SPIN", "MEASUREMENT_TIME", "SHORTCUT",
    "OWN_SOLVER", "CERTIFIED", "LEAVES_PATH",
    "ACCELERATES", "RECOVERY_UNIT", "RELAX_UNIT", "RISE", "BLOCKED_RATE", "REIN_SLOPE", "OFF_PATH_DISTANCE",
    "OFF_PATH_ANGLE",
    "POSTURE_GAIN", "CENTRING", "MANIPULABILITY", "POSTURE_SHARE",
    "LOOKS_AHEAD", "CAPS_SPEED", "CELL", "JOINT_STEP", "SLOPE_STEP", "SHORTEST", "CURVATURE_SHARE", "DOUBT",
    "SLOPE_CAP", "ROOM", "SINGULAR_RATE", "NEWTON_STEPS",
    "SLOW_FROM", "HOLD_FROM", "LET_IN", "NOISE_MARGIN", "RECOVERY_TIME", "FAULT_FROM", "STALL_SAMPLES", "STALL_SHARE",
    "SILENT_TIME", "FILTER_TIME", "DT_LOW", "DT_HIGH", "JOINT_JUMP", "WATCHES_FORCE", "FORCE_LIMIT", "SERVO_DELAY",
    "APART_HOLD",
    "ELBOWS",
)  # fmt: skip

#: Scalars of the state: the loop, the watch, the drift filter, the forces, the look-ahead.
LOOP = (
    "CLOCK", "RATE", "LAST_DT", "HAS_PREDICTED", "FIRST", "DRIFTED", "CORRECTING", "FAULT", "FAULT_ARM", "FAULT_A",
    "FAULT_B", "PATH_LOST", "AWAY", "OVERRIDDEN", "PAUSE", "EASE",
    "QUIET_SLACK", "QUIET_APPROACH", "QUIET_AHEAD", "STARTED", "MISMATCH", "CHAIN_HELD", "SAID", "OUTDATED",
    "SHIFT_ASKED", "RATE_SLOPE",
)  # fmt: skip
WATCH = (
    "SAMPLES", "WATCH_RATE", "WATCH_ARM", "SILENCE", "PRESSED", "HAS_SEEN", "PAST_COUNT", "PAST_HEAD", "FAR_SAMPLES",
    "DRIFT_SPEED", "DRIFT_SINCE", "DRIFT_STARTED", "VAR_DRIFT", "COVARIANCE", "VAR_LAG",
    "REST", "HAS_COMMANDED", "BEHIND", "GAP", "PULL",
    "LAG_LOW", "LAG_HIGH", "LAG_HASTE", "LAG_NOISE", "LAG_BEGUN", "LAG_SUSPECTS",
)  # fmt: skip
AHEAD = (
    "HEAD", "COUNT", "KNOWN", "FRESH", "COMPLETE", "ENDS", "FREE_UNTIL", "BEGIN_AT",
    "GROWING", "TRY_SPAN", "ITERATION", "WAY", "BEYOND", "BEYOND_AT", "KEPT", "SOUGHT", "KINKS",
    "SEEKING", "CLOSING_IN", "SEEK_FROM", "SEEK_TO", "SEEK_WHOLE", "KINK", "JUMP_AT", "JUMP_BY", "STEEP_BY",
    "STEEP_AT",
)  # fmt: skip
#: Numbers of a knot beside its vectors.
KNOT = (
    "K_CLOCK", "K_SPAN", "K_CAP", "K_UNCAPPED", "K_FASTEST", "K_CHANGE", "K_INSIDE", "K_CORNER", "K_FALL", "K_RISE",
    "K_KIND", "K_ARM", "K_JOINT", "K_SQUARE", "K_CAUSE_KIND", "K_CAUSE_ARM", "K_CAUSE_JOINT", "K_STOPS",
    "K_FOUND", "K_SINCE", "K_UNTIL", "K_GAIN",
)  # fmt: skip
#: The proposal of a step. REASON comes with an arm (or an index) and two numbers.
PROPOSAL = (
    "DT", "CAP", "SPAN", "HAS_MEASURED", "CAP_KIND", "CAP_ARM", "CAP_JOINT", "WATCH_CAP", "HOLD", "FAULTS",
    "REASON", "REASON_ARM", "REASON_A", "REASON_B", "OUTCOME", "NEW_RATE", "BINDING_ROW", "BINDING_SIDE",
    "GRASP_SHARE", "PATH_SHARE", "PARTING", "BRAKED", "ITERATIONS", "OUTSIDE", "RELAXED", "PLACED", "LATE", "KEEP",
    "BINDINGS", "ROWS", "APART", "CHAIN_HOLDS", "MISMATCH_LEFT", "MISMATCHED", "HAS_ERRORS", "CLOSES",
    "MADE",
)  # fmt: skip
#: The record of a step, before its vectors q, velocity, q_next, off_path, and four numbers per binding limit: kind,
#: arm, joint, constraint, each −1 if it does not apply.
RECORD = (
    "R_DT", "R_CLOCK", "R_CLOCK_NEXT", "R_RATE", "R_STATUS", "R_REASON", "R_REASON_ARM", "R_REASON_A", "R_REASON_B",
    "R_GRASP_SHARE", "R_PATH_SHARE", "R_PARTING", "R_OUTCOME", "R_ITERATIONS", "R_BINDINGS", "R_AWAY", "R_TURNED",
    "R_MEASURED", "R_APART",
)  # fmt: skip
#: Scalars of the relaxation of forces: settings, then state; see minding.h for the arrays behind them.
MINDING = (
    "WRENCH_FILTER", "DEAD_BAND", "RELAX_TIME", "DRIFT_TIME", "RAMP_TIME", "WRENCH_SILENCE",
    "MOST_SPEED", "MOST_SPIN", "MOST_REACH", "MOST_TURN",
    "WAIT", "MOVE_BELOW", "PRESSED_BELOW", "FORCE_SLOWS", "FORCE_HOLDS", "HAS_PALMS", "SQUEEZE", "MOST_SQUEEZE",
    "SIZE", "STIFFER", "RELAX_EASE", "SATURATED",
    "STAGE", "SINCE", "STEPPED", "AGE", "ASKED", "FORCE_CAP", "LAST_RATE", "LAST_SPEED", "AT_END",
    "FRICTION_USED", "PRESSED_WITH", "NEEDED",
    "SENSOR_FAULT", "SENSOR_ARM", "SENSOR_AMOUNT", "ALLOWED", "WHY", "WHY_ARM",
    "RIGID", "WEIGHT_X", "WEIGHT_Y", "WEIGHT_Z", "HASTE", "SUSPECTED", "SERVO_SAMPLES", "SERVO_NOISE", "CORRECTS",
    "START_SIZE", "WAY_DONE",
    "LOAD_MASS", "CONTACT_LIMIT", "LOAD_HASTE", "TOUCHES", "PUSHED", "SHARPEST", "ASKED_DT", "REFERENCE_DT",
    "CONTACT_LATE", "GOES_ON", "BACK_SPEED", "BACK_OWED", "BACK_FROM", "BACKS", "LOAD_SPEED",
)  # fmt: skip
#: Stages of a run with forces, in this order.
STAGES = ("CHECKING", "PRESSING", "RELAXING", "MOVING")
#: Readings of the sensors in a step.
HEARING = ("HEARD", "MISSED", "SILENT")
#: Faults of a sensor: silent for SENSOR_AMOUNT seconds; SENSOR_AMOUNT newtons from the servos' estimate.
SENSORS = ("SENSORS_FINE", "SENSOR_SILENT", "SENSOR_WRONG")
#: Why the object may move at ALLOWED only; NOTHING_MORE: the operator asks for no more.
WHYS = ("NOTHING_MORE", "BY_SENSOR", "BY_REACH", "BY_STAGE", "BY_FRICTION", "BY_FORCE", "BY_CONTACT")
#: Members of Status, in the order of their codes.
STATUSES = ("TRACKING", "SLOWED", "BLOCKED", "HOLDING", "FAULTED", "PAUSED", "OFF_PATH")

#: FILLED: base and columns are filled in for another solver. OPEN: the plain definition has to answer. ASK: rows may
#: bind that the constraints have not given yet.
OUTCOMES = ("NOMINAL", "RAY", "QP", "FILLED", "OPEN", "ASK")
#: Members of LimitKind, in the order of their codes; 0 is none.
KINDS = (
    "NONE", "POSITION", "VELOCITY", "ACCELERATION", "SINGULARITY", "REACH", "PATH_END", "OUT_OF_STEP", "CONSTRAINT",
    "OVERRIDE", "PATH_JUMP",
)  # fmt: skip
REASONS = (
    "NO_REASON", "BAD_DT", "NOT_FINITE", "OFF_CIRCLE", "JUMPED", "CHAIN_APART", "CHAIN_PARTED", "OUT_OF_STEP_BY",
    "WAS_OUT_OF_STEP", "STALLED", "ALL_STALLED", "FORCE", "HANGS_BEHIND", "PATH_FAILED", "PATH_JUMPS",
    "LOOK_AHEAD_FAILED", "CONSTRAINT_FAILED", "OFF_SERVOS", "TOUCHING", "OFF_LAG",
)  # fmt: skip

#: The fields of each block: name and size.
CONFIG = (
    ("arm_start", "n"), ("arm_size", "n"),
    ("link_R", "9 * nv"), ("link_p", "3 * nv"), ("prismatic", "nv"), ("continuous", "nv"), ("q_index", "nv"),
    ("object_R", "9 * n"), ("object_p", "3 * n"), ("tool_p", "3 * n"),
    ("scale", "nv"), ("shares", "6 * n"), ("low", "nv"), ("high", "nv"), ("speed", "nv"), ("acceleration", "nv"),
    ("unit", "unknowns"), ("at_grasps", "36"), ("levers", "3 * n"), ("softness", "nv"),
    ("posture_cap", "nv"), ("posture_bounded", "nv"), ("posture_middle", "nv"),
    ("plan_speed", "nv"), ("plan_acceleration", "nv"), ("plan_jump", "nv"), ("plan_room", "nv"), ("slope_change", "nv"),
    ("most_move", "nv"),
    ("options", str(len(OPTIONS))),
)  # fmt: skip
STATE = (
    ("loop", str(len(LOOP))), ("positions", "nv"), ("velocity", "nv"), ("before", "nv"), ("predicted", "6 * n"),
    ("foreseen", "6 * n"),
    ("mismatch", "6 * n"), ("grasp_shift", "6 * n"), ("asked_shift", "6 * n"), ("drift", "6"), ("correcting", "6"),
    ("posture_target", "nv"),
    ("quiet_centre", "nv"), ("quiet_reach", "nv"), ("quiet_ahead_centre", "nv"), ("quiet_ahead_reach", "nv"),
    ("watch", str(len(WATCH))), ("deviation", "6 * n"), ("away", "6 * n"), ("away_step", "6 * n"), ("noise", "n"),
    ("stalled", "n"), ("widest", "n"), ("lost", "n"), ("seen", "nq"), ("history", "2 * nv * past"),
    ("slow_drift", "6 * n"), ("lag", "6 * n"), ("apart", "6 * n"), ("drift_last", "nv"),
    ("lag_base", "6"), ("lag_told", "6"), ("lag_way", "6"),
    ("deflection", "nv"), ("way", "nv"), ("commanded", "nv"), ("forces", "n"),
    ("ahead", str(len(AHEAD))), ("ahead_R", "9 * n"), ("ahead_p", "3 * n"), ("kinks", str(MOST_KINKS)),
    ("seek_low", "12"), ("seek_high", "12"), ("told_velocity", "nv"),
    ("knots", f"{len(KNOT)} * knots"), ("knot_positions", "nv * knots"), ("knot_slope", "nv * knots"),
    ("knot_curvature", "nv * knots"), ("knot_edges", "nv * knots"),
)  # fmt: skip
WORK = (
    ("proposal", str(len(PROPOSAL))), ("near_x", "nv"), ("near_sin", "nv"), ("near_cos", "nv"), ("carried", "12 * n"),
    ("jacobian", "6 * nv"), ("R", "9"), ("p", "3"), ("along", "6"), ("path", "6"), ("measured", "6"),
    ("measured_positions", "nv"), ("measured_carried", "12 * n"), ("measured_away", "6 * n"),
    ("measured_moved", "6 * n"),
    ("posture_work", "7 * nv"), ("common", "6"), ("errors", "6 * n"), ("grasp", "6 * n"), ("offsets", "6 * n"),
    ("left_over", "6 * n"), ("foresees", "6 * n"), ("made", "6 * n"), ("best_offsets", "6 * n"),
    ("best_foresees", "6 * n"), ("best_guess", "nv"),
    ("null_along", "nv"), ("null_offset", "nv"), ("command", "nv"), ("stand_in", "nv"), ("guess", "nv"),
    ("first_guess", "nv"), ("along_velocity", "nv"), ("off_path", "6"), ("lower", "nv"), ("upper", "nv"),
    ("recovery", "nv"), ("outside", "nv"), ("further", "nv * rows"), ("further_lower", "rows"),
    ("further_upper", "rows"), ("further_soft", "rows"), ("further_owner", "rows"), ("base", "nv + rows"),
    ("columns", "(nv + rows) * unknowns"), ("x", "unknowns + nv + rows"), ("bindings", "4 * (nv + rows)"),
    ("record", f"{len(RECORD)} + 2 * nq + nv + 6 + 4 * (nv + rows)"), ("sketch", "24 * n + 9 * nv"),
    ("least_pivot", "n"),
    ("lines", "3 * (4 * nv + 4)"),
    ("evading_positions", "nv"), ("evading_slope", "nv"),
    ("scratch", "scratch"),
)  # fmt: skip

BLOCKS = (("CONFIG", CONFIG), ("STATE", STATE), ("WORK", WORK))


def sizes(*, n: int, nv: int, nq: int, unknowns: int, past: int, rows: int) -> dict[str, int]:
    """The symbols that sizes of fields are written in.

    Args:
        n, nv, nq: arms, joints, numbers of a configuration.
        unknowns: of the condensed QP without the slacks of recovery and relaxation.
        past: samples in which a stall is looked for.
        rows: further rows that constraints may have; those that brake all arms together come after them.
    """
    rows += 1 + n + nv
    x, m = unknowns + nv + rows, 2 * nv + rows  # unknowns and rows of the largest QP
    scratch = x * m + 3 * (m + x) + 2 * x * (x + 3) + 64 * n + 8 * nv
    return {
        "n": n, "nv": nv, "nq": nq, "unknowns": unknowns, "past": past, "rows": rows, "knots": MOST_KNOTS,
        "scratch": scratch,
    }  # fmt: skip


def offsets(block: tuple[tuple[str, str], ...], symbols: dict[str, int], *, gap: int = 0) -> dict[str, tuple[int, int]]:
    """Where each field of a block begins and ends, with a gap of unused numbers after each."""
    return dict(_offsets(block, tuple(symbols.items()), gap))


@functools.lru_cache(maxsize=64)
def _offsets(
    block: tuple[tuple[str, str], ...], sizes: tuple[tuple[str, int], ...], gap: int
) -> dict[str, tuple[int, int]]:
    symbols = dict(sizes)
    places, begin = {}, 0
    for name, size in block:
        end = begin + _value(size, symbols)
        places[name] = (begin, end)
        begin = end + gap
    return places


def _value(size: str, symbols: dict[str, int]) -> int:
    """Value of a sum of products of symbols, numbers and bracketed sums, such as ``6 + 4 * (nv + rows)``."""
    words = size.replace("(", "( ").replace(")", " )").split()

    def product() -> int:
        total = 1
        while True:
            word = words.pop(0)
            total *= summed() if word == "(" else symbols[word] if word in symbols else int(word)
            if not words or words[0] != "*":
                return total
            words.pop(0)

    def summed() -> int:
        total = product()
        while words and words.pop(0) == "+":
            total += product()
        return total

    return summed()


#: Lists of names, by what counts them in the header.
LISTS = {
    "OPTIONS": OPTIONS, "LOOP": LOOP, "WATCH": WATCH, "AHEAD": AHEAD, "KNOT": KNOT, "PROPOSAL": PROPOSAL,
    "OUTCOMES": OUTCOMES, "KINDS": KINDS, "REASONS": REASONS, "RECORD": RECORD, "STATUSES": STATUSES,
    "MINDING": MINDING, "STAGES": STAGES, "HEARING": HEARING, "SENSORS": SENSORS, "WHYS": WHYS,
}  # fmt: skip
