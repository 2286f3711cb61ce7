"""The docs as a site: `make docs` writes build/docs/index.html, which opens from disk."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import zmq
from jupyter_client.manager import KernelManager

import interarea

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER / "site"))  # commands, catalogue
# cells call `interarea` as a reader does, wherever the environment is
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
for pool in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(pool, "1")

# kernels talk by TCP with keys of their own: nobody else on this machine reads along, and builds do not meet
if zmq.has("curve") and hasattr(KernelManager, "transport_encryption"):
    KernelManager.transport_encryption.default_value = "auto"

project = "interarea"
author = "The interarea developers"
version = release = interarea.__version__
extensions = [
    "catalogue",  # docs/site: devices, variables and the explorer, written from what the package holds
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.doctest",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",
]
exclude_patterns = ["site"]
nitpicky = True
# types of other packages, and words of numpydoc's type lines, are no pages of this site
nitpick_ignore_regex = [(r"py:.*", r".*")]

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True

autodoc_typehints = "none"  # the docstrings say shapes and units
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_theme = "pydata_sphinx_theme"
html_title = "interarea"
html_static_path = ["site/static"]
html_css_files = ["interarea.css"]
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "navbar_end": ["theme-switcher"],
}
html_context = {"default_mode": "auto"}
html_show_sourcelink = False
html_show_search_summary = False  # a page from disk may not fetch another one
html_copy_source = False
copyright = "the interarea developers, BSD-3-Clause"
