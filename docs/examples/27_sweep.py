"""Many runs, on all cores.  python docs/examples/27_sweep.py"""

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

from coopqp.studies import Local, load_study, sweep
from coopqp.visualization import save_figure, sweep_figure

STUDIES = Path(__file__).parent / "studies"
folder = Path(tempfile.mkdtemp())
made = {}
for name in ("gains_and_noise", "speed_and_grasp"):
    study = load_study(STUDIES / f"{name}.toml")
    made[name] = sweep(study, Local(2), folder / name)
    print(
        f"{name}: {len(study)} rows over {', '.join(study.varied)}; {dict(made[name].outcomes)}"
    )


def median(runs, column, **values):
    """Of the rows with these values of keys (dots written as __)."""
    wanted = {key.replace("__", "."): value for key, value in values.items()}
    rows = [r for r in runs.rows if all(r[key] == value for key, value in wanted.items())]
    return float(np.median([r[column] for r in rows]))


print("change of the joints' speeds from step to step, with encoders off by up to 1e-4 rad:")
runs = made["gains_and_noise"]
for gain in dict(runs.study.axes)["controller.path_gain"]:
    row = {"controller__path_gain": gain, "disturbances__encoder_noise_rad": 1e-4}
    print(f"  path_gain {gain:5.1f} 1/s: {median(runs, 'unrest_deg_per_s', **row):.3f} °/s")

print("the lift in 0.3 s:")
runs = made["speed_and_grasp"]
for case in ("narrow grasp", "wide grasp"):
    for kind in ("pseudo_inverse", "qp"):
        row = {"case": case, "controller__kind": kind, "scenario__duration": 0.3}
        drift, share = (median(runs, column, **row) for column in ("eps_p_mm", "speed_share"))
        print(f"  {case}, {kind}: arms drift {drift:.2g} mm, {100 * share:.0f} % of the speed")

if "--out" in sys.argv:
    out = Path(sys.argv[sys.argv.index("--out") + 1])
    for name, runs in made.items():
        save_figure(sweep_figure(runs), out / f"{name}.png", dpi=80)
shutil.rmtree(folder)
