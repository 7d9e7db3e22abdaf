"""On PYTHONPATH, this lets a copy of the package that is further on there be imported in place of the installed one.

Python imports it when it starts. An editable installation finds its package before PYTHONPATH is searched.
"""

import sys

sys.meta_path[:] = [finder for finder in sys.meta_path if type(finder).__name__ != "ScikitBuildRedirectingFinder"]
