/* Under the address sanitizer the fields of the memory stand apart, and nobody may touch what is between them while the
 * core runs. Python copies whole blocks of it: there the gaps are open. */

#ifndef COOPQP_GUARDS_H
#define COOPQP_GUARDS_H

#if defined(__SANITIZE_ADDRESS__)
#define GUARDED
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define GUARDED
#endif
#endif

#ifdef GUARDED
#include <sanitizer/asan_interface.h>
#define GAP 4 /* numbers after each field */

static inline void guard_gap(const double *gap, bool closed) {
    if (closed) ASAN_POISON_MEMORY_REGION(gap, GAP * sizeof(double));
    else ASAN_UNPOISON_MEMORY_REGION(gap, GAP * sizeof(double));
}
#else
#define GAP 0
static inline void guard_gap(const double *, bool) {}
#endif

#endif
