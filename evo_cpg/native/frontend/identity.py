"""Keys of programs: equal keys have equal machine code.

Lowering takes as long as all other work of a start whose machine code is on disk. So a program is
looked up by what it computes, before it is lowered (`evo_cpg.native.native.compiled`).
"""

import functools
import hashlib
import platform
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from evo_cpg import native
from evo_cpg.native import machine_constants
from evo_cpg.native.backend.code import Variant
from evo_cpg.native.backend.machine import llvm_version
from evo_cpg.native.frontend.lower import CALLS, inner_program
from evo_cpg.native.frontend.primitives import Program


class _Opaque(Exception):
    """A parameter is a Python function, which has no key."""


def note_of(program: Program, variant: Variant) -> str | None:
    """Return a name for a kind of machine code of a program.

    Return None if the program holds Python functions, as derivatives do.
    """
    writer = _Writer()
    try:
        writer.value(program)
    except _Opaque:
        return None
    constants = {name: x for name, x in vars(machine_constants).items() if name.isupper()}
    words = [*_made_by(), *map(str, variant), str(constants), *writer.words]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:32]


@functools.cache
def _made_by() -> list[str]:
    """Return the source of the back end, and the versions of what it depends on."""
    sources = [file.read_text() for file in sorted(Path(native.__path__[0]).rglob("*.py"))]
    versions = jax.__version__, np.__version__, llvm_version(), sys.version, platform.platform()
    return [*sources, *versions]


class _Writer:
    """Writer of all that a program computes. Names of variables and parts do not matter."""

    def __init__(self):
        self.words: list[str] = []
        self._known: dict[Jaxpr, int] = {}
        self._types: dict[Any, str] = {}

    def value(self, x: Any) -> None:
        """Write a parameter."""
        if isinstance(x, Program):
            self.value((x.shared, x.tangents, x.forward, x.constants, x.jaxpr))
        elif isinstance(x, ClosedJaxpr):
            self.value((x.consts, x.jaxpr))
        elif isinstance(x, Jaxpr):
            self._jaxpr(x)
        elif isinstance(x, (tuple, list)):
            self.words.append(f"{type(x).__name__} {len(x)}")
            for each in x:
                self.value(each)
        elif isinstance(x, (np.ndarray, np.generic, jax.Array)):
            found = np.asarray(x)
            self.words.append(f"{found.dtype.str} {found.shape} {found.tobytes().hex()}")
        elif callable(x) and not isinstance(x, type):
            raise _Opaque
        else:
            text = repr(x)
            if " at 0x" in text:
                raise _Opaque
            self.words.append(f"{type(x).__name__} {text}")

    def _jaxpr(self, x: Jaxpr) -> None:
        """Write a program of JAX, or its number if it was written before."""
        if x in self._known:
            self.words.append(f"program {self._known[x]}")
            return
        self._known[x] = len(self._known)
        names: dict[Any, int] = {}

        def atoms(given: Any) -> None:
            for atom in given:
                if isinstance(atom, Literal):
                    self.value(np.asarray(atom.val))
                elif atom in names:
                    self.words.append(str(names[atom]))
                else:
                    names[atom] = len(names)
                    self.words.append(self._type(atom.aval))

        atoms((*x.constvars, *x.invars))
        for equation in x.eqns:
            self.words.append(equation.primitive.name)
            atoms(equation.invars)
            atoms(equation.outvars)
            if equation.primitive.name in CALLS:
                self.value(inner_program(equation))
            else:
                for key, given in equation.params.items():
                    self.words.append(key)
                    self.value(given)
        self.words.append("results")
        atoms(x.outvars)

    def _type(self, aval: Any) -> str:
        if aval not in self._types:
            self._types[aval] = str(aval)
        return self._types[aval]
