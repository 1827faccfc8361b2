"""Entry point of a child process that ends with the page's program, even if that is killed.

``python -m evo_cpg.view.drawing_page.tethered train ...`` is `evo-cpg train ...`, which interrupts
itself as Control-C does when its standard input closes. The system closes it when the page's
program ends.
"""

import _thread
import os
import runpy
import signal
import threading


def _interrupt_at_the_end_of_input() -> None:
    # A thread inside a file object would hold its lock when Python ends, which Python refuses.
    while os.read(0, 4096):
        pass
    _thread.interrupt_main()


if __name__ == "__main__":
    # A shell that starts the page's program in the background lets its processes ignore interrupts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Thread(target=_interrupt_at_the_end_of_input, daemon=True).start()
    runpy.run_module("evo_cpg", run_name="__main__", alter_sys=True)
