/* What every module of Python in C needs, once. */

#ifndef COOPQP_POINTER_H
#define COOPQP_POINTER_H

/* CPython passes functions as void *, which ISO C forbids and every platform with dynamic libraries allows. */
#if defined(__GNUC__)
#define POINTER(type, address) (__extension__(type)(address))
#else
#define POINTER(type, address) ((type)(address))
#endif

#endif
