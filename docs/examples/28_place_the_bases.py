"""Where may bases stand?  python docs/examples/28_place_the_bases.py"""

import sys
from pathlib import Path

import numpy as np

from coopqp import QPController, simulate
from coopqp.baselines import PseudoInverseController
from coopqp.scenarios import abb_lift, kuka_lift, mixed_lift, paper_lift
from coopqp.simulation import read_run
from coopqp.studies import Placer, load_place_study
from coopqp.visualization import placement_figure, save_figure

study = load_place_study(Path(__file__).parent / "studies" / "h_and_b.toml")

# 1. The paper's cell, and why its slaves stand where they do.
now = study.now
print(now.explain())
print("h = 3.0:", study.at({"h": 3.0, "b": 0.5}).arms[2].why)
print("b = 0.1:", study.at({"h": 3.6, "b": 0.1}).explain().splitlines()[-1])

# 2. Too far away: what helps.
far = study.at({"h": 3.9, "b": 0.5})
print(*study.placer.remedies(far), sep="\n")

# 3. The map over h and b.
placed = study.map()
best = max(placed, key=lambda cell: cell.rank)
possible = sum(cell.feasible for cell in placed)
print(f"{possible} of {len(placed)} places are possible; best:", dict(best.values))
print(best.explain().splitlines()[-2])

# 4. The same lift by other robots, at bases found in this way.
for make in (paper_lift, kuka_lift, abb_lift, mixed_lift):
    lift = make()
    cell = Placer.of(lift).cell_at([arm.T_world_base for arm in lift.cell.arms])
    drift = {}
    for kind in (PseudoInverseController, QPController):
        controller = kind(lift.cell, lift.grasp, lift.path, dt=lift.dt)
        run = simulate(controller, q_start=lift.q_start)
        drift[kind] = read_run(lift.cell, run).eps_p_mm.max()
    paper, qp = drift.values()
    sigma = min(arm.sigma_min for arm in cell.arms)
    margin = np.rad2deg(min(arm.margin for arm in cell.arms))
    print(f"{lift.name}: σ_min {sigma:.3f}, margin {margin:.0f}°;", end=" ")
    print(f"ε_p of the paper's algorithm {paper:.3f} mm, of the QP {qp:.0e} mm")

if "--out" in sys.argv:
    figure = placement_figure(study.name, placed, units=study.units, now=now, best=best)
    save_figure(figure, Path(sys.argv[sys.argv.index("--out") + 1]) / "h_and_b.png", dpi=80)
