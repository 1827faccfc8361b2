"""Commands that leave what they make in a run folder keep others off it meanwhile."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from evo_cpg.locks import LockedError
from evo_cpg.training.run_folder import RunFolder


@contextlib.contextmanager
def writing(run: Path, output: Path | None = None, option: str = "") -> Iterator[None]:
    """Lock a run folder for as long as the block lasts, if the command writes into it.

    Args:
        run: the run folder.
        output: file or folder that the command writes; None for a place in the run folder.
        option: of the command line, which chooses another place; empty where there is none.

    Raises:
        LockedError: another process writes into the folder.
        OutputError: nobody can write into it.
    """
    folder = RunFolder(run)
    elsewhere = output is not None and not Path(os.path.abspath(output)).is_relative_to(
        os.path.abspath(run)
    )
    # That there is no run the command says, after what is wrong with its options.
    if elsewhere or not folder.config.is_file():
        yield
        return
    with contextlib.ExitStack() as lock:
        try:
            lock.enter_context(folder.locked())
        except LockedError as error:
            way_out = f", or write elsewhere with {option}" if option else ""
            raise LockedError(f"{error}{way_out}") from None
        yield
