/* The core as one unit: compiled for any processor and, where ARITHMETIC names another table, once more for a newer one. */

#include "functions.h"

#include "kinematics.c"
#include "paths.c"
#include "chain.c"
#include "limits.c"
#include "ldp.c"
#include "program.c"
#include "watch.c"
#include "residual.c"
#include "apart.c"
#include "quiet.c"
#include "sharing.c"
#include "horizon.c"
#include "redundancy.c"
#include "chain_ahead.c"
#include "growth.c"
#include "preview.c"
#include "braking.c"
#include "step.c"
#include "servo.c"
#include "relax.c"
#include "allow.c"

#ifndef ARITHMETIC
#define ARITHMETIC arithmetic_plain
#endif

const Arithmetic ARITHMETIC = {start,       start_path, observe, propose,             answer,         commit,
                               read_answer, quiet_step, expect_shift, carry, carry_and_linearise, least_distance,
                               go_over,     relax,      allow};
