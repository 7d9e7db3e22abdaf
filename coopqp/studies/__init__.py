"""Studies: thousands of runs on the cores of a machine or on a cluster, and where the bases of a cell may stand.

A sweep, in the order of its flow: ``study`` (a file of axes and draws gives rows), ``drawing`` (disturbances),
``row`` (one run gives one row), ``engines`` (where rows are run), ``dispatch`` (until all rows are there),
``journal`` (finished rows, on disk), ``table`` and ``sweeping`` (the folder of a study). Base placement: ``placing``
(one placement), ``placement`` (a file of axes, a map, a search).
"""

from coopqp.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__, extra=("studies", "pydantic", "annotated_types"))
