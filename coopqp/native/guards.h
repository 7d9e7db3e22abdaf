/* Under the address sanitizer the fields of the memory stand apart, and nobody may touch what is between them while the
 * core runs. Python owns the memory and copies whole blocks of it: there the gaps are open. */

#ifndef COOPQP_GUARDS_H
#define COOPQP_GUARDS_H

#if defined(__SANITIZE_ADDRESS__)
#define GUARDED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define GUARDED 1
#endif
#endif

#ifdef GUARDED
#include <sanitizer/asan_interface.h>

#define GAP 4 /* numbers after each field */

struct Guards {
    const Arithmetic *can;
    double *end[FIELDS_IN_ALL];
};

static Guards *guards_of(const Core *c);

static void guard(const Core *c, int closed) {
    const Guards *guards = guards_of(c);
    for (int i = 0; i < FIELDS_IN_ALL; i++) {
        if (closed) ASAN_POISON_MEMORY_REGION(guards->end[i], GAP * sizeof(double));
        else ASAN_UNPOISON_MEMORY_REGION(guards->end[i], GAP * sizeof(double));
    }
}

#define RUN(c, call) \
    guard(c, 1);     \
    call;            \
    guard(c, 0)

static void guarded_start(Core *c, const double *positions) { RUN(c, guards_of(c)->can->start(c, positions)); }
static void guarded_start_path(Core *c, double clock, double rate) {
    RUN(c, guards_of(c)->can->start_path(c, clock, rate));
}
static void guarded_observe(Core *c, const double *q, const double *dt) { RUN(c, guards_of(c)->can->observe(c, q, dt)); }
static int guarded_propose(Core *c) {
    RUN(c, const int found = guards_of(c)->can->propose(c));
    return found;
}
static int guarded_answer(Core *c) {
    RUN(c, const int found = guards_of(c)->can->answer(c));
    return found;
}
static int guarded_commit(Core *c) {
    RUN(c, const int found = guards_of(c)->can->commit(c));
    return found;
}
static int guarded_read(Core *c, double cap) {
    RUN(c, const int found = guards_of(c)->can->read(c, cap));
    return found;
}
static int guarded_quiet(const Core *c) {
    RUN(c, const int found = guards_of(c)->can->quiet(c));
    return found;
}
static void guarded_linearise(const Core *c, const double *positions, const double *about, double *carried,
                              double *jacobian) {
    RUN(c, guards_of(c)->can->linearise(c, positions, about, carried, jacobian));
}

static int guarded_go_over(Core *c, const double *goal, double speed, double spin, double full, double *numbers) {
    RUN(c, const int found = guards_of(c)->can->go_over(c, goal, speed, spin, full, numbers));
    return found;
}

/* The same calls, guarded. */
static const Arithmetic *guarded(const Core *c, const Arithmetic *can) {
    static Arithmetic calls;
    guards_of(c)->can = can;
    calls = *can;
    calls.start = guarded_start, calls.start_path = guarded_start_path, calls.observe = guarded_observe;
    calls.propose = guarded_propose, calls.answer = guarded_answer, calls.commit = guarded_commit;
    calls.read = guarded_read, calls.quiet = guarded_quiet;
    calls.linearise = guarded_linearise, calls.go_over = guarded_go_over;
    return &calls;
}
#else
#define GAP 0
#define guard(c, closed) ((void)(c))
#define guarded(c, can) (can)
#endif

#endif
