"""Examples of the classes of this page: each section is shown at the classes that it names; all are run by a test."""

# %% before
from pathlib import Path

from coopqp.scenarios import paper_lift

Path("gains.toml").write_text("""name = "gains"
scenario = "paper_lift"
seed = 1
figures = ["object_mm"]
[set]
steps = 40
[axes]
controller.path_gain = [10.0, 20.0]
""")

# %% coopqp.studies.Study
from coopqp.studies import load_study

study = load_study("gains.toml")
assert len(study) == 2

# %% coopqp.studies.Engine, coopqp.studies.Local, coopqp.studies.Sweep
from coopqp.studies import Local, sweep

answer = sweep(study, Local(1), Path("out"))
print(dict(answer.outcomes), answer.rows[0])

# %% coopqp.studies.Cluster
from coopqp.studies import Cluster


def on_a_cluster(address):
    """Rows on all workers of a Dask scheduler, such as tcp://scheduler:8786."""
    return sweep(study, Cluster(address), Path("out"))


# %% coopqp.studies.Placer, coopqp.studies.CellPlaced, coopqp.studies.ArmPlaced
from coopqp.studies import Placer

lift = paper_lift()
placer = Placer.of(lift)
placed = placer.cell_at([arm.T_world_base for arm in lift.cell.arms])
assert placed.feasible
print(placed.arms[0].explain())

# %% coopqp.studies.Goals
from coopqp.studies import Goals

strict = Placer(lift.cell, lift.grasp, lift.path, goals=Goals(sigma_min=0.3))

# %% coopqp.studies.PlaceStudy
from coopqp.studies import load_place_study

Path("places.toml").write_text("""name = "places"
scenario = "paper_lift"
[axes]
h = { low = 3.4, high = 3.8, number = 3, now = 3.6 }
[[bases]]
arm = "slave_1"
xyz_m = ["h", 0.5, 0]
yaw_deg = 180
""")
places = load_place_study("places.toml")
assert places.now.feasible
best = max(places.map(), key=lambda cell: cell.rank)
print(dict(best.values))
