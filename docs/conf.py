"""Sphinx settings of the documentation: `sphinx-build -W --keep-going docs docs/_build`."""

import sys
from pathlib import Path

import dune_rl

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "dune_rl"
author = "dune_rl contributors"
copyright = author
release = dune_rl.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "expand_pages", "films", "parameter_tables", "short_types"]
exclude_patterns = ["_build", "_ext"]

myst_enable_extensions = ["attrs_inline", "dollarmath"]
myst_heading_anchors = 3

# Docstrings have Markdown's single backticks.
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = "dune_rl"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_copyright = False
html_theme_options = {"top_of_page_buttons": []}
