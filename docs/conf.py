import sys
from pathlib import Path

from carosac_toolkit import __version__

sys.path.insert(0, str(Path(__file__).parent))

import gallery
import notebooks

project = "CaRoSaC Toolkit"
author = "The CaRoSaC Toolkit developers"
copyright = "2026, the CaRoSaC Toolkit developers"
release = version = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["style.css"]
html_title = f"CaRoSaC Toolkit {release}"

linkcheck_timeout = 30
linkcheck_anchors_ignore_for_url = [r"https://github\.com/"]  # drawn by scripts

myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3

nb_execution_mode = "cache"  # filled by `notebooks.make`
nb_execution_cache_path = str(notebooks.CACHE)
nb_execution_raise_on_error = True
nb_execution_timeout = notebooks.CELL_TIME_MAX_S
nb_output_stderr = "remove"  # of Warp, which says what it compiles

default_role = "code"  # single backticks in docstrings are code
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
suppress_warnings = ["ref.python"]  # words such as n in "shape (B, n)" are no references


def make(app):
    """Draw the gallery and run the notebooks."""
    gallery.make()
    notebooks.make()


def setup(app):
    """Make pages and outputs before pages are looked for."""
    app.connect("builder-inited", make)
