"""Slow down, pause, resume, start again in mid-path.  python docs/examples/17_reins.py"""

from coopqp import QPController, Status, chain_error, path_error, tool_placements
from coopqp.scenarios import paper_lift

lift = paper_lift(time_law="quintic")
cell = lift.cell.with_limits(acceleration=5.0)
controller = QPController(cell, lift.grasp, lift.path, dt=0.002)
controller.reset(lift.q_start)

OPERATOR = {  # at which tick
    400: lambda: controller.set_override(0.4),
    600: controller.pause,
    900: controller.resume,
    1100: lambda: controller.set_override(1.0),
}
step, last, arms, path = None, Status.TRACKING, 0.0, 0.0
for tick in range(5000):
    OPERATOR.get(tick, lambda: None)()
    if tick == 800:  # at rest: the controller may be reset where it is, and is still paused
        controller.reset(step.q_next, clock=step.clock_next)
    step = controller.step()
    if step.status is not last:
        print(f"{tick * 0.002:.3f} s: {step.explain()}")
        last = step.status
    tools = tool_placements(cell, [step.q_next])[0]
    arms = max(arms, chain_error(tools, lift.grasp)[0])
    path = max(path, path_error(tools, lift.grasp, lift.path, step.clock_next)[0])
    if step.finished:
        break
print(f"finished after {tick * 0.002:.2f} s; arms agree to {1e6 * arms:.2g} µm, off the path by {1e6 * path:.2g} µm")
