/* Singular values of several matrices at once. */

#ifndef COOPQP_VALUES_H
#define COOPQP_VALUES_H

#define LANES 8       /* matrices */
#define MOST_VALUES 6 /* of a matrix */
#define MOST_ROWS 64  /* or columns, of which there are more */

using SingularValues = void(const double *const A[LANES], int rows, int columns, double *const values[LANES]);

namespace plain {
SingularValues singular_values;
}
namespace avx2 {
SingularValues singular_values;
}

#endif
