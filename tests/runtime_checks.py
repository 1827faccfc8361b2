"""Type checker that `conftest` applies to every function and class of the package."""

import beartype

# An int is allowed for a float, as in PEP 484.
typechecker = beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))
