"""QP-based cooperative control of several robot arms that hold one object.

Each package is one part of the flow. It imports from itself and from those above it only:

* ``errors``, ``core``, ``checks``, ``spatial``, ``output``, ``lazy``, ``shown``, ``version``: what all others use;
* ``model``: the arms, the cell, the grasp, the closed chain;
* ``paths``: where the object should be, and when;
* ``solvers``: QP solvers behind one interface;
* ``constraints``: further constraints of a user, before the motion and in it;
* ``collision``: shapes, pairs and distances, and the constraint that keeps them;
* ``planning``: before the motion: feasibility, starts, timing;
* ``control``: one step, from the measured configuration to the command, and the look-ahead;
* ``baselines``: controllers to compare with: the paper's, and one for each arm alone;
* ``forces``: the wrenches between the arms and the object;
* ``simulation``: plants, the loop, recordings and their evaluation;
* ``scenarios``: ready cells and tasks;
* ``drivers``: the control loop on robots, drivers, simulated robots;
* ``files``: cell files and exports;
* ``studies``: many runs, and where bases may stand;
* ``visualization``, ``cli``: pictures, the command ``coopqp``.

The names that most programs need are here, the others in their packages.
"""

from coopqp.lazy import attach, moved
from coopqp.version import __version__ as __version__

__getattr__, __dir__, __all__ = attach(__name__, __file__)

_ONE = "the core makes every step, and without it nothing runs; coopqp --version names its version"
moved(
    "coopqp.native",
    "coopqp.core",
    gone=dict.fromkeys(("available_kernels", "kernel_text", "warn_once", "compiled"), _ONE),
)
