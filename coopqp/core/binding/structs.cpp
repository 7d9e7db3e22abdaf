/* The structs of the memory for Python: the members that it reads or writes. Flags and codes take any number. */

#include "../core.h"

#include "arrays.h"

template <typename S, typename T>
static void add_member(nb::class_<S> &to, const char *name, T S::*at) {
    if constexpr (std::is_same_v<T, double>) {
        to.def_rw(name, at);
    } else {
        using Shown = std::conditional_t<std::is_enum_v<T>, int, T>;
        to.def_prop_rw(name, [at](const S &s) { return static_cast<Shown>(s.*at); },
                       [at](S &s, double x) { s.*at = static_cast<T>(static_cast<Shown>(x)); });
    }
}

/* Names in the order of their codes. */
static nb::tuple names_of(std::initializer_list<const char *> names) {
    nb::list found;
    for (const char *name : names) found.append(name);
    return nb::tuple(found);
}

#define MEMBER(name) add_member(of, #name, &S::name);
#define NAMED(name) #name,

void bind_structs(nb::module_ &m) {
    m.attr("OUTCOMES") = names_of({OUTCOMES(NAMED)}), m.attr("LIMIT_KINDS") = names_of({LIMIT_KINDS(NAMED)});
    m.attr("STATUSES") = names_of({STATUSES(NAMED)}), m.attr("REASONS") = names_of({REASONS(NAMED)});
    {
        using S = Options;
        nb::class_<S> of(m, "Options");
        MEMBER(nominal_dt) MEMBER(grasp_gain) MEMBER(path_gain) MEMBER(correction_speed) MEMBER(correction_spin)
        MEMBER(measurement_time) MEMBER(recovery_unit) MEMBER(relax_unit) MEMBER(part_unit) MEMBER(calm_unit) MEMBER(rise)
        MEMBER(blocked_rate) MEMBER(override_slope) MEMBER(off_path_distance) MEMBER(off_path_angle) MEMBER(posture_gain)
        MEMBER(centring) MEMBER(manipulability) MEMBER(cell) MEMBER(joint_step) MEMBER(slope_step) MEMBER(shortest)
        MEMBER(curvature_share) MEMBER(doubt) MEMBER(slope_cap) MEMBER(room) MEMBER(singular_rate) MEMBER(slow_from)
        MEMBER(hold_from) MEMBER(drift_limit) MEMBER(noise_margin) MEMBER(recovery_time) MEMBER(fault_from) MEMBER(stall_share)
        MEMBER(silent_time) MEMBER(filter_time) MEMBER(dt_low) MEMBER(dt_high) MEMBER(joint_jump) MEMBER(force_limit)
        MEMBER(servo_delay) MEMBER(apart_hold) MEMBER(newton_steps) MEMBER(stall_samples) MEMBER(elbows) MEMBER(shortcut)
        MEMBER(own_solver) MEMBER(certified) MEMBER(leaves_path) MEMBER(accelerates) MEMBER(looks_ahead) MEMBER(caps_speed)
        MEMBER(watches_force)
    }
    {
        using S = Loop;
        nb::class_<S> of(m, "Loop");
        of.def("__copy__", [](const S &s) { return S(s); }).def("assign", [](S &s, const S &other) { s = other; });
        MEMBER(clock) MEMBER(rate) MEMBER(rate_slope) MEMBER(override_rate) MEMBER(posture_blend) MEMBER(quiet_slack)
        MEMBER(quiet_approach) MEMBER(quiet_ahead_slack) MEMBER(status) MEMBER(has_drift) MEMBER(paused)
    }
    {
        using S = Travels;
        nb::class_<S> of(m, "Travels");
        MEMBER(stride) MEMBER(left) MEMBER(count)
    }
    {
        using S = Node;
        nb::class_<S> of(m, "Node");
        of.def("limit_by", [](S &s, int constraint) { s.limit = {CONSTRAINT, -1, constraint}; });
        MEMBER(clock) MEMBER(span) MEMBER(cap) MEMBER(fall) MEMBER(rise)
    }
    {
        using S = Proposal;
        nb::class_<S> of(m, "Proposal");
        MEMBER(dt) MEMBER(cap) MEMBER(span) MEMBER(watch_cap) MEMBER(new_rate) MEMBER(has_measured) MEMBER(hold) MEMBER(reason)
        MEMBER(reason_index) MEMBER(outcome) MEMBER(braked) MEMBER(rows) MEMBER(asked_solver) MEMBER(outside)
    }
    {
        using S = Record;
        nb::class_<S> of(m, "Record");
        of.def_static("of", [](const nb::bytes &numbers) {
            S found;
            check_fit(numbers.size() >= sizeof found);
            memcpy(&found, numbers.data(), sizeof found);
            return found;
        });
        of.attr("NUMBERS") = NUMBERS(S), of.attr("dt_at") = offsetof(S, dt);
        of.attr("clock_at") = offsetof(S, clock), of.attr("clock_next_at") = offsetof(S, clock_next);
        MEMBER(rate) MEMBER(reason_a) MEMBER(reason_b) MEMBER(grasp_share) MEMBER(path_share) MEMBER(parting) MEMBER(away)
        MEMBER(turned) MEMBER(apart) MEMBER(status) MEMBER(reason) MEMBER(reason_index) MEMBER(outcome) MEMBER(iterations)
        MEMBER(bindings) MEMBER(measured) MEMBER(braked)
    }
    {
        using S = ForceRelaxation;
        nb::class_<S> of(m, "ForceRelaxation");
        of.def_static("of", [](nb::object memory) { /* at the begin of an array, which it keeps */
            Out numbers;
            check_fit(numbers.take(memory.ptr()) && numbers.size >= (Py_ssize_t)NUMBERS(S));
            return nb::cast(reinterpret_cast<S *>(numbers.data), nb::rv_policy::reference_internal, memory);
        });
        of.attr("NUMBERS") = NUMBERS(S), of.attr("size_for") = nb::cpp_function(relaxation_size);
        MEMBER(wrench_filter) MEMBER(dead_band) MEMBER(relax_time) MEMBER(drift_time) MEMBER(ramp_time)
        MEMBER(wrench_silence) MEMBER(most_speed) MEMBER(most_spin) MEMBER(most_reach) MEMBER(most_turn) MEMBER(wait_time)
        MEMBER(move_below) MEMBER(pressed_below) MEMBER(force_slows) MEMBER(force_holds) MEMBER(squeeze)
        MEMBER(most_squeeze) MEMBER(largest_force) MEMBER(stiffer) MEMBER(relax_blend) MEMBER(stage_time) MEMBER(age) MEMBER(asked)
        MEMBER(force_cap) MEMBER(last_rate) MEMBER(last_speed) MEMBER(friction_used) MEMBER(pressed_with) MEMBER(needed)
        MEMBER(sensor_amount) MEMBER(allowed) MEMBER(weight_x) MEMBER(weight_y) MEMBER(weight_z) MEMBER(joint_acceleration)
        MEMBER(servo_samples) MEMBER(servo_noise) MEMBER(correction_share) MEMBER(start_size) MEMBER(joint_way) MEMBER(load_mass)
        MEMBER(contact_limit) MEMBER(load_acceleration) MEMBER(touches) MEMBER(pushed) MEMBER(sharpest) MEMBER(asked_dt)
        MEMBER(reference_dt) MEMBER(contact_late) MEMBER(retreat_speed) MEMBER(retreat_left) MEMBER(retreat_from) MEMBER(retreats_at)
        MEMBER(load_speed) MEMBER(look_at) MEMBER(stage) MEMBER(sensor_fault) MEMBER(why) MEMBER(sensor_arm)
        MEMBER(why_arm) MEMBER(has_palms) MEMBER(rigid) MEMBER(saturated) MEMBER(stepped) MEMBER(at_end)
        MEMBER(suspected) MEMBER(goes_on)
    }
}
