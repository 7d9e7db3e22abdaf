"""Studies: thousands of runs on the cores of a machine or on a cluster, and where the bases of a cell may stand.

A sweep, in the order of its flow: ``study`` (a file of axes and draws gives rows), ``drawing`` (disturbances),
``row`` (one run gives one row), ``engines`` (where rows are run), ``dispatch`` (until all rows are there),
``journal`` (finished rows, on disk), ``table`` and ``sweeping`` (the folder of a study). Base placement: ``placing``
(one placement), ``placement`` (a file of axes, a map, a search).
"""

from typing import TYPE_CHECKING

from coopqp.lazy import lazy_names

if TYPE_CHECKING:
    from coopqp.studies.dispatch import run_rows
    from coopqp.studies.engines import Cluster, Engine, Local
    from coopqp.studies.errors import EngineError, StudyError
    from coopqp.studies.placement import PlaceStudy, load_place_study
    from coopqp.studies.placing import ArmPlaced, CellPlaced, Goals, Placer
    from coopqp.studies.study import Study, load_study
    from coopqp.studies.sweeping import Sweep, sweep
else:
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "coopqp.studies.engines": "Cluster Engine Local",
            "coopqp.studies.errors": "EngineError StudyError",
            "coopqp.studies.placement": "PlaceStudy load_place_study",
            "coopqp.studies.placing": "ArmPlaced CellPlaced Goals Placer",
            "coopqp.studies.study": "Study load_study",
            "coopqp.studies.sweeping": "Sweep sweep",
            "coopqp.studies.dispatch": "run_rows",
        },
        extra=("studies", "pydantic", "annotated_types"),
    )

__all__ = [
    "ArmPlaced",
    "CellPlaced",
    "Cluster",
    "Engine",
    "EngineError",
    "Goals",
    "Local",
    "PlaceStudy",
    "Placer",
    "Study",
    "StudyError",
    "Sweep",
    "load_place_study",
    "load_study",
    "run_rows",
    "sweep",
]
