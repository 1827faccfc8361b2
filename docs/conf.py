"""Sphinx settings; `make docs` builds with warnings as errors."""

from importlib.metadata import version as installed_version

project = "evo_cpg"
author = "The evo_cpg authors"
project_copyright = author
release = version = installed_version("evo-cpg")

extensions = ["myst_parser", "sphinx.ext.mathjax"]
# Of the studies the pages include what `evo-cpg reproduce` made.
exclude_patterns = ["_build", "paper", "reproduction/*/*"]
nitpicky = True

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

html_theme = "furo"
html_title = f"evo_cpg {release}"
