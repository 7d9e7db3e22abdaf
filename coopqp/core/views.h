/* Fields of the memory, as Eigen sees them: vectors, and matrices whose columns are twists or points. */

#ifndef COOPQP_VIEWS_H
#define COOPQP_VIEWS_H

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/Jacobi>

using Vector3 = Eigen::Vector3d;
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Matrix6 = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
using Matrix6X = Eigen::Matrix<double, 6, Eigen::Dynamic>;

using Given = Eigen::Map<const Eigen::VectorXd>; /* numbers that are only read */
using Ref6 = Eigen::Ref<Vector6>;

/* A placement: as 12 numbers of the memory, the rotation row by row. */
template <typename M, typename V>
struct PoseOf {
    M R;
    V p;
};
using Pose = PoseOf<Matrix3, Vector3>;
static_assert(sizeof(Pose) == 12 * sizeof(double));

/* A view that also is the pointer to its first number. */
template <typename M>
struct View : Eigen::Map<M> {
    using Base = Eigen::Map<M>;
    using Base::operator=;
    View() : Base(nullptr, M::RowsAtCompileTime < 0 ? 0 : M::RowsAtCompileTime, M::ColsAtCompileTime < 0 ? 0 : M::ColsAtCompileTime) {}
    View(double *at, Eigen::Index rows, Eigen::Index columns) : Base(at, rows, columns) {}
    operator double *() const { return const_cast<double *>(this->data()); }
    double &operator[](Eigen::Index i) const { return const_cast<double *>(this->data())[i]; }
};

using Vector = View<Eigen::VectorXd>;                                /* a number of each joint, or arm */
using Twists = View<Matrix6X>;                                       /* a twist of each */
using Points = View<Eigen::Matrix3Xd>;
using Twist = View<Vector6>;
using Square = View<Matrix6>;

/* A field begins at a place in memory, and has so many numbers. */
template <typename T>
void place(T *&field, double *at, size_t) {
    field = reinterpret_cast<T *>(at);
}
template <typename M>
void place(View<M> &field, double *at, size_t size) {
    const int fixed = M::RowsAtCompileTime;
    const Eigen::Index rows = fixed < 0 ? (Eigen::Index)size : fixed;
    new (&field) View<M>(at, rows, (Eigen::Index)size / rows);
}

#endif
