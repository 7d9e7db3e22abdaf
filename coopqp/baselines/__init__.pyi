from .independent import (
    IndependentQPController as IndependentQPController,
)
from .independent import (
    IndependentQPOptions as IndependentQPOptions,
)
from .pseudo_inverse import (
    PseudoInverseController as PseudoInverseController,
)
from .pseudo_inverse import (
    PseudoInverseOptions as PseudoInverseOptions,
)
