/* What self-motion of redundant arms costs beyond its speed, so that no limit shakes them to and fro.
 *
 * A step's QP is linear in the self-motion, which costs next to nothing. Where a limit binds, the smallest slope of its
 * joint along the self-motion would be worth all the speed that the accelerations allow: past the place where the slope
 * is 0, and back in the next step, for ever. But the slope changes on the way: joints bend by b = −A⁺ Ȧ w under the
 * self-motion w = N z. So a QP whose limits bind with the multipliers λ is solved again with a cost of at least ½ T λᵀb
 * for z, which leads to where the slope is 0 in the time T, and no further. All self-motion of arms that move together
 * costs as much: z is small where the limits leave it little, and its direction would be made of rounding. */

#include "functions.h"

/* Put the units of the self-motions that the QP's solution asks for into the columns; 0 where they may stay. */
static int shrink_units(Core *c, double h) {
    const double time = max_of(APPROACH_TIME, APPROACH_STEPS * h);
    const Given x(c->x, c->unknowns);
    OfRows columns = columns_of(c);
    Twists bends(c->scratch, 6, c->arms);
    Vector w(c->scratch + 6 * c->arms, c->joints, 1), back(w + c->joints, c->joints, 1), nothing(back + c->joints, c->joints, 1);
    const int own = c->unknowns - TWIST_AND_SHARES;
    int shrunk = 0;
    w = columns.topRows(c->joints).rightCols(own).lazyProduct(x.tail(own));
    for (int k = 0; k < c->arms; k++) bends.col(k) = bend(c, k, c->jacobian, w);
    if (!two_velocities(c, c->jacobian, bends, Vector6::Zero(), nullptr, nullptr, back, nothing)) return 0;
    for (int k = 0, z = TWIST_AND_SHARES; k < c->arms; k++) {
        if (!leads_group(c, k)) continue;
        const Group *g = group_of(c, k);
        const int joints = joints_together(c, k), extra = std::max(joints - 6 * (g ? g->arms : 1), 0), at = z;
        z += extra;
        const double size = x.segment(at, extra).squaredNorm();
        if (!(size > 0.0) || follows_way(c, k)) continue;
        double cost = 0.0;
        for (int i = 0; i < joints; i++) cost -= c->pull[joint_together(c, k, i)] * back[joint_together(c, k, i)];
        cost *= time / size;
        if (!(cost > 1.0)) continue;
        columns.middleCols(at, extra) /= sqrt(cost);
        shrunk = 1;
    }
    return shrunk;
}
