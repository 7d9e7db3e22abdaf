/* The core as one unit: compiled for any processor and, where BUILD names another one, once more for a newer one. All of
 * it stands in a namespace of that name: of two templates or inline functions alike the linker keeps one, and this one's
 * instructions would run in the other build, too. So Eigen has another name in each: see CMakeLists.txt. */

#include "core.h"

#ifndef BUILD
#define BUILD plain
#endif

namespace BUILD {

#include "functions.h"

#include "kinematics.cpp"
#include "paths.cpp"
#include "grasps.cpp"
#include "ways.cpp"
#include "chain.cpp"
#include "few_joints.cpp"
#include "limits.cpp"
#include "ldp.cpp"
#include "program.cpp"
#include "groups.cpp"
#include "watch.cpp"
#include "residual.cpp"
#include "lagging.cpp"
#include "apart.cpp"
#include "quiet.cpp"
#include "sharing.cpp"
#include "horizon.cpp"
#include "redundancy.cpp"
#include "chain_ahead.cpp"
#include "growth.cpp"
#include "preview.cpp"
#include "braking.cpp"
#include "self_motion.cpp"
#include "brake.cpp"
#include "step.cpp"
#include "servo.cpp"
#include "relax.cpp"
#include "allow.cpp"

const Arithmetic arithmetic = {start, start_path, observe, propose, commit, try_step, jumps, move_grasp, relax_before_step, relax_after_step,
                               carry_and_linearise, least_distance, retarget, relax, allow};

}  // namespace BUILD
