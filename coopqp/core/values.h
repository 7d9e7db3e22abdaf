/* Singular values of many matrices. */

#ifndef COOPQP_VALUES_H
#define COOPQP_VALUES_H

#include <stddef.h>

#define LANES 8       /* matrices at once */
#define MOST_VALUES 6 /* of a matrix */
#define MOST_ROWS 64  /* or columns, of which there are more */

/* Those of `count` matrices, one after the other. */
using SingularValues = void(const double *matrices, ptrdiff_t count, int rows, int columns, double *values);

namespace plain {
SingularValues singular_values;
}
namespace avx2 {
SingularValues singular_values;
}

#endif
