"""Settings of Sphinx: `make docs` builds the pages of this folder, and those that follow from the code before them."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
ROOT = FOLDER.parent
sys.path.insert(0, str(ROOT))
os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
os.environ["MPLBACKEND"] = "agg"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import truewrench  # noqa: E402, found by the path above
from docs.generator.catalogue_pages import write_catalogue  # noqa: E402
from docs.generator.command_page import write_command_page  # noqa: E402
from docs.generator.notebook_pages import write_notebooks  # noqa: E402
from docs.generator.style_sheet import write_style_sheet  # noqa: E402

project = "truewrench"
release = version = truewrench.__version__
copyright = "the truewrench authors, Apache License 2.0"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "docs.generator.mathml_formula",
    "docs.generator.docstring_text",
]
exclude_patterns = ["generator", "**/.ipynb_checkpoints"]
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb"}
html_theme = "furo"
html_title = f"truewrench {release}"
html_static_path = ["static", "generated/static"]
html_css_files = ["sketches.css", "manual.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sourcelink = False
pygments_style = "friendly"
pygments_dark_style = "monokai"

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "amsmath"]
myst_heading_anchors = 3
nb_execution_timeout = 120
nb_execution_in_temp = True
nb_execution_raise_on_error = False  # a failure is a warning, with its traceback, and a warning an error
nb_execution_show_tb = True
nb_execution_mode = "force"
nb_execution_excludepatterns = ["*.ipynb"]
nb_merge_streams = True

default_role = "code"
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_rtype = False


def setup(app: Any) -> None:
    """Write the pages that follow from the code, before any page is read; static files before Sphinx looks for them."""
    write_style_sheet(FOLDER / "generated" / "static")
    app.connect("builder-inited", lambda _: _generate())


def _generate() -> None:
    write_command_page(FOLDER / "generated")
    write_notebooks(FOLDER / "generated" / "notebooks")
    if not os.environ.get("TRUEWRENCH_DOCS_KEEP"):
        write_catalogue(FOLDER / "generated" / "catalogue")
