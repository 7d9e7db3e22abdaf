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

/* A call of the arithmetic, with the gaps closed as long as it lasts. */
template <auto CALL, typename R, typename C, typename... Args>
R guarded_call(C *c, Args... args) {
    struct Closed {
        const Core *core;
        explicit Closed(const Core *one) : core(one) { guard(core, 1); }
        ~Closed() { guard(core, 0); }
    } closed(c);
    return (guards_of(c)->can->*CALL)(c, args...);
}

template <auto CALL, typename R, typename C, typename... Args>
void guard_call(Arithmetic &calls, R (*Arithmetic::*)(C *, Args...)) {
    calls.*CALL = guarded_call<CALL, R, C, Args...>;
}

/* The same calls, guarded. */
static const Arithmetic *guarded(const Core *c, const Arithmetic *can) {
    static Arithmetic calls;
    guards_of(c)->can = can;
    calls = *can;
#define GUARD(name) guard_call<&Arithmetic::name>(calls, &Arithmetic::name);
    GUARD(start) GUARD(start_path) GUARD(observe) GUARD(propose) GUARD(answer)
    GUARD(commit) GUARD(read) GUARD(quiet) GUARD(linearise) GUARD(go_over)
    return &calls;
}
#else
#define GAP 0
#define guard(c, closed) ((void)(c))
#define guarded(c, can) (can)
#endif

#endif
