"""Sphinx settings; `make docs` builds with warnings as errors."""

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "evo_cpg"
author = "The evo_cpg authors"
project_copyright = author
release = version = installed_version("evo-cpg")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "config_keys",
    "notebook_pages",
]
# Of the studies the pages include what `evo-cpg reproduce` made.
exclude_patterns = ["_build", "paper", "reproduction/*/*"]
nitpicky = True
# Docstrings name types of other projects, and parts of ours that are not on the site.
nitpick_ignore_regex = [("py:.*", ".*")]

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "substitution"]
myst_substitutions = {"release": release}
myst_heading_anchors = 3

# What stands in single backticks in a docstring is a link where it can be one, and else code.
default_role = "py:obj"
add_module_names = False
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "none"
napoleon_attr_annotations = False
napoleon_numpy_docstring = False
napoleon_use_ivar = True

html_theme = "furo"
html_title = f"evo_cpg {release}"


def _without_constructor(app, what, name, *_):
    """Nobody builds these classes but the program; a class of your own has fields of its own."""
    return ("", None) if what in ("class", "exception") else None


def setup(app):
    """Called by Sphinx."""
    app.connect("autodoc-process-signature", _without_constructor)
