"""Lock a run folder against other processes while a command writes to it."""

import contextlib
import functools
import inspect
import os
from collections.abc import Callable, Iterator
from pathlib import Path


def writes_to_run(parameter: str = "", option: str = "") -> Callable[[Callable], Callable]:
    """Return a decorator that locks the folder `run` while a command writes there.

    Args:
        parameter: parameter of the command that names another place to write to, if any.
        option: option of the command line for that parameter, for messages.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        signature = inspect.signature(command)

        @functools.wraps(command)
        def locked(*values: object, **options: object) -> None:
            given = signature.bind(*values, **options).arguments
            with _locked(given["run"], given.get(parameter), option):
                command(*values, **options)

        return locked

    return decorate


@contextlib.contextmanager
def _locked(run: Path, output: Path | None, option: str) -> Iterator[None]:
    """Lock a run folder unless the output goes elsewhere.

    Raises:
        LockedError: another process writes to the folder.
        OutputError: the folder is read-only.
    """
    from evo_cpg.locks import LockedError
    from evo_cpg.training.run_folder import RunFolder

    folder = RunFolder(run)
    elsewhere = output is not None and not Path(os.path.abspath(output)).is_relative_to(
        os.path.abspath(run)
    )
    # The command itself reports a missing run, after errors in its options.
    if elsewhere or not folder.config.is_file():
        yield
        return
    with contextlib.ExitStack() as lock:
        try:
            lock.enter_context(folder.locked())
        except LockedError as error:
            advice = f", or write elsewhere with {option}" if option else ""
            raise LockedError(f"{error}{advice}") from None
        yield
