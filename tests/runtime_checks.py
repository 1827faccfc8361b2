"""The type checker that `conftest` switches on for every function and class of the package."""

import beartype

# An int may stand where a float is asked for, as PEP 484 has it.
typechecker = beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))
