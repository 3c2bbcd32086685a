import sys
from pathlib import Path

from carosac_toolkit import __version__

sys.path.insert(0, str(Path(__file__).parent))

import gallery

project = "CaRoSaC Toolkit"
author = "The CaRoSaC Toolkit developers"
copyright = "2026, the CaRoSaC Toolkit developers"
release = version = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"CaRoSaC Toolkit {release}"

myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3

default_role = "code"  # single backticks in docstrings are code
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
suppress_warnings = ["ref.python"]  # words such as n in "shape (B, n)" are no references


def setup(app):
    """Draw the gallery before pages are looked for."""
    app.connect("builder-inited", lambda _: gallery.make())
