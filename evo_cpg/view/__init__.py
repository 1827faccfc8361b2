"""Films, plots and previews.

VTK and Matplotlib load with the module that needs them (`film`, `preview`, `plots`), so that a
training run never pays for them.
"""

from evo_cpg.system import lend_matplotlib_a_folder

lend_matplotlib_a_folder()
