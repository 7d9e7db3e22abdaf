/* Arrays of Python as arguments: contiguous, of float64. Anything else is a TypeError of the call; lengths are compared
 * by who takes them. They stay where they are as long as they are held. */

#ifndef COOPQP_ARRAYS_H
#define COOPQP_ARRAYS_H

#include <nanobind/nanobind.h>

#include <utility>

#include "../spans.h"

namespace nb = nanobind;

/* `T` is double, or const double for those that are only read. With `OR_NONE` it may be None: data is null then. */
template <typename T, bool OR_NONE = false>
class Numbers : public Span<T> {
public:
    using Span<T>::data;
    using Span<T>::size;

    Numbers() = default;
    Numbers(Numbers &&other) noexcept { *this = std::move(other); }
    Numbers &operator=(Numbers &&other) noexcept {
        std::swap(data, other.data), std::swap(size, other.size), std::swap(view, other.view);
        return *this;
    }
    ~Numbers() { release(); }

    void release() {
        if (view.obj) PyBuffer_Release(&view);
        data = nullptr, size = 0, view.obj = nullptr;
    }

    bool take(PyObject *object) noexcept {
        const int flags = PyBUF_FORMAT | PyBUF_C_CONTIGUOUS | (std::is_const_v<T> ? 0 : PyBUF_WRITABLE);
        if (OR_NONE && object == Py_None) return true;
        if (PyObject_GetBuffer(object, &view, flags) < 0) {
            PyErr_Clear();
            return false;
        }
        if (view.itemsize != 8 || !view.format || view.format[0] != 'd' || view.format[1]) return false;
        data = static_cast<T *>(view.buf), size = view.len / 8;
        return true;
    }
    bool is_row(Py_ssize_t numbers) const { return view.ndim == 1 && size == numbers; }
    Py_ssize_t length(int axis) const { return axis < view.ndim ? view.shape[axis] : 1; }

private:
    Py_buffer view = {};
};

template <typename T, bool OR_NONE>
struct nanobind::detail::type_caster<Numbers<T, OR_NONE>> {
    using Taken = Numbers<T, OR_NONE>;
    NB_TYPE_CASTER(Taken, const_name("numpy.typing.NDArray[numpy.float64]") + const_name<OR_NONE>(" | None", ""))
    bool from_python(handle src, uint32_t, cleanup_list *) noexcept { return value.take(src.ptr()); }
};

template <typename T>
struct nanobind::detail::has_arg_defaults<Numbers<T, true>> : std::true_type {}; /* None is no wrong argument */

/* Of functions of the core itself. */
template <typename T>
struct nanobind::detail::type_caster<Span<T>> {
    Numbers<T> value;
    static constexpr auto Name = type_caster<Numbers<T>>::Name;
    template <typename>
    using Cast = Span<T>;
    bool from_python(handle src, uint32_t, cleanup_list *) noexcept { return value.take(src.ptr()); }
    template <typename>
    bool can_cast() const noexcept {
        return true;
    }
    explicit operator Span<T>() { return value; }
};

using Out = Numbers<double>;
using In = Numbers<const double>;
using InOrNone = Numbers<const double, true>;

/* The parts of the module. */
void bind_step(nb::module_ &m);
void bind_kinematics(nb::module_ &m);
void bind_distances(nb::module_ &m);
void bind_constants(nb::module_ &m);
void bind_structs(nb::module_ &m);

#endif
