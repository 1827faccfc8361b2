"""Sphinx settings; `make docs` builds with warnings as errors."""

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "tools"))

project = "evo_cpg"
author = "The evo_cpg authors"
project_copyright = author
release = version = installed_version("evo-cpg")

extensions = ["myst_parser", "sphinx_copybutton", "mathml", "animal_pages", "notebook_pages"]
# The pages of the studies contain the tables in these folders, see `generate.py`.
exclude_patterns = ["_build", "paper", "reproduction/*/*"]
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "substitution"]
myst_substitutions = {"release": release}
myst_heading_anchors = 3

html_theme = "furo"
html_title = f"evo_cpg {release}"
html_static_path = ["static"]
html_css_files = ["docs.css"]
html_math_renderer = "mathml"
# The summaries of results would be read from other files, which browsers refuse for `file:`.
html_show_search_summary = False
html_show_sourcelink = False
html_copy_source = False
# Prompts and output are not copied.
copybutton_exclude = ".linenos, .gp, .go"
