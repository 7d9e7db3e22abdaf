from .independent import (
    IndependentQPController as IndependentQPController,
    IndependentQPOptions as IndependentQPOptions,
)
from .pseudo_inverse import (
    PseudoInverseController as PseudoInverseController,
    PseudoInverseOptions as PseudoInverseOptions,
)
