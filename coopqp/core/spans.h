/* Numbers that somebody else holds, and the error of those that do not fit. */

#ifndef COOPQP_SPANS_H
#define COOPQP_SPANS_H

#include <stddef.h>

#include <stdexcept>

template <typename T>
struct Span {
    T *data = nullptr;
    ptrdiff_t size = 0;
};
using Read = Span<const double>;
using Write = Span<double>;

inline void check_fit(bool good, const char *what = "the arrays do not fit together") {
    if (!good) throw std::invalid_argument(what);
}

#endif
