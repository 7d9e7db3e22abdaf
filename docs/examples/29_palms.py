"""Carry a box between open palms.  python docs/examples/29_palms.py [--out FOLDER]"""

import sys

from coopqp import ForceController, ForceOptions, InvalidInputError, QPController
from coopqp.forces import Grip, least_squeeze
from coopqp.planning import Payload
from coopqp.scenarios import palm_box

box = palm_box()
palm = Grip(kind="palm", friction=0.6, radius=0.06)
weight = [0, 0, 9.81 * box.object_mass, 0, 0, 0]
least = least_squeeze([palm, palm], box.grasp, [weight])
print(f"{box.object_mass:g} kg need {least:.1f} N at each palm")

controller = QPController(box.cell, box.grasp, box.path, dt=box.dt)
payload = Payload(mass=box.object_mass, centre=[0, 0, 0])
settings = {"stiffness": 1e4, "payload": payload, "palms": [palm, palm]}
try:
    ForceController(controller, ForceOptions(squeeze=150.0, **settings))
except InvalidInputError as error:
    print("refused:", error)
held = ForceController(controller, ForceOptions(squeeze=200.0, **settings))

if "--out" in sys.argv:
    from pathlib import Path

    from coopqp.simulation import read_loads, run_in_engine
    from coopqp.visualization import run_loads_figure

    figure = run_loads_figure(box.cell, read_loads(box.cell, run_in_engine(box)))
    figure.savefig(Path(sys.argv[sys.argv.index("--out") + 1]) / "palms.png", dpi=80)
