/* The module coopqp.core._core. */

#include "arrays.h"

NB_MODULE(_core, m) {
    m.doc() = "The compiled parts of coopqp.";
    nb::set_leak_warnings(false); /* users would see them where their program ends */
    bind_step(m);
    bind_kinematics(m);
    bind_distances(m);
    bind_constants(m);
    bind_structs(m);
}
