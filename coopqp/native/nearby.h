/* The rows of a compiled step beside obstacles; see nearby.cpp. */

#ifndef COOPQP_NEARBY_H
#define COOPQP_NEARBY_H

#include <Python.h>

/* Add the type Nearby to the module; -1 and an exception if that fails. */
int add_nearby(PyObject *module);

#endif
