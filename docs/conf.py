"""Settings of the documentation's site; `scripts/docs.sh` builds it."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path.insert(0, str(ROOT))

import bsk_torch  # noqa: E402
from docs import gallery  # noqa: E402
from docs._ext import inventories  # noqa: E402

if TYPE_CHECKING:
    from sphinx.application import Sphinx

QUICK = bool(os.environ.get("BSK_TORCH_DOCS_QUICK"))
"""Whether tutorials are shown without being run."""

BARE = bool(os.environ.get("BSK_TORCH_DOCS_BARE"))
"""Whether pages of the reference have no sidebar, whose tree takes half of the time of a build: for tests."""

project = "bsk_torch"
author = "the authors of bsk_torch"
copyright = "the authors of bsk_torch, MIT license"
version = release = bsk_torch.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.intersphinx",
    "myst_parser",
    "sphinx_copybutton",
    "sphinx_sitemap",
    "sphinx_llms_txt",
    "sphinx_gallery.gen_gallery",
    "docs._ext.mathml",
    "docs._ext.reference",
    "docs._ext.site",
]
exclude_patterns = ["_build", "tutorials/*.rst", "**/README.md"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
nitpicky = True
suppress_warnings = ["config.cache"]  # settings hold functions

# Markdown
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
html_math_renderer = "mathml"

# docstrings
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_typehints_format = "short"
autoclass_content = "both"  # arguments are described where __init__ is
autodoc_member_order = "bysource"
autosummary_generate = False
add_module_names = False
python_maximum_signature_line_length = 100
modindex_common_prefix = ["bsk_torch."]

# other projects: tables kept here, because the build has no network
intersphinx_mapping = inventories.write(
    HERE / "inventories", HERE / "_build" / "inventories"
)
intersphinx_timeout = 1

# programs and tutorials as pages
sphinx_gallery_conf = gallery.settings(execute=not QUICK)

# the site
html_theme = "furo"
html_title = f"bsk_torch {version}"
html_static_path = ["_static"]
html_favicon = "_static/favicon.svg"
html_css_files = ["site.css"]
html_baseurl = os.environ.get("BSK_TORCH_DOCS_URL", "http://localhost:8000/")
html_show_sphinx = False
sitemap_url_scheme = "{link}"
sitemap_show_lastmod = False
llms_txt_title = "bsk_torch"
llms_txt_summary = bsk_torch.__doc__
copybutton_exclude = ".linenos, .gp, .go"
html_theme_options = {"navigation_with_keys": True, "top_of_page_buttons": []}


def without_tree(
    app: Sphinx,
    pagename: str,
    templatename: str,
    context: dict[str, Any],
    doctree: object,
) -> None:
    """Leave out the tree of all pages, which the theme resolves again for each page."""
    if pagename.startswith("api/reference/"):
        context["toctree"] = lambda **_: ""


def setup(app: Sphinx) -> None:
    """Change pages before the theme looks at them."""
    if BARE:
        app.connect("html-page-context", without_tree, priority=400)
