"""Configuration of the documentation site; ``python docs/build.py`` builds and checks it."""

from __future__ import annotations

import sys
from pathlib import Path

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS / "_extensions"))

import pandas  # noqa: E402

import nfbench  # noqa: E402
from nfbench import analysis  # noqa: E402
from nfbench.results import Evidence  # noqa: E402
from nfbench.results import results as results_module  # noqa: E402

# What the annotations of Results mention, and its module imports for type checkers only.
vars(results_module).update(pd=pandas, Axis=analysis.Axis, Evidence=Evidence)
vars(results_module).update(Ranking=analysis.Ranking, Target=analysis.Target)

project = "nfbench"
author = "The nfbench maintainers"
copyright = f"2026, {author}"  # Sphinx's name for it
version = release = nfbench.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "api_docstrings",
    "column_tables",
    "command_reference",
    "mathml",
    "option_tables",
    "repository_pages",
]
exclude_patterns = ["_build", "_extensions", "examples", "gallery/*.py", "gallery/*.ipynb"]
suppress_warnings = ["config.cache"]  # sphinx_gallery_conf holds no function, but is not compared between builds

smartquotes = False  # options and values are typed with straight quotes and two hyphens

# MyST: what the pages use beyond plain Markdown
myst_enable_extensions = ["dollarmath", "colon_fence", "attrs_inline", "deflist"]
myst_heading_anchors = 3

# Everything that a page loads is in the built folder: no fonts, scripts or formulas from elsewhere.
html_theme = "furo"
html_title = f"nfbench {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

# API reference from the docstrings; a name that an annotation mentions must be documented or come from elsewhere
autodoc_member_order = "bysource"
autodoc_inherit_docstrings = False
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
nitpick_ignore_regex = [
    # other libraries, whose inventories cannot be read without a network
    (
        r"py:.*",
        r"(numpy|np|pandas|pd|matplotlib|jaxtyping|pydantic|annotated_types|typing|pathlib|collections|importlib|types)\..*",
    ),
    (r"py:.*", r"(ndarray|Float|Complex|Int|Figure|Path|DataFrame|Any|Callable|Iterable|Iterator|Sequence|Mapping)"),
    (
        r"py:.*",
        r"(ABC|Protocol|Enum|StrEnum|Exception|BaseException|ValueError|abc\.ABC|enum\.StrEnum|Annotated|Literal)",
    ),
    (r"py:.*", r"(int|float|str|bool|bytes|dict|list|tuple|set|type|object|None|optional|PluginOption|final|inf)"),
    (r"py:class", r"[a-z] [a-z]|[a-z*]+ \w+|'.*'|\d.*|T|_F|F|.*\.T"),  # shapes and type variables
    (r"py:class", r"nfbench\.core\.options\.Annotated.*|Annotated\[.*"),
    (  # types of options and of arrays
        r"py:class",
        r"_?(Finite|Positive|Points?|Decibels|Wavelength|Wavefront|Speed|Shaped|MAX_NUMBERS|Frequency|AnyArray|Axis)",
    ),
    (r"py:class", r"nfbench\.problems\.near_field\.(search\.general\.State|calibration\.Knowledge)"),
    # base classes and records that are private to a package
    (r"py:.*", r"nfbench\.(core|plugins|study|analysis|results|execution|figures|testing)\.\w+\.\w+"),
    (r"py:.*", r"nfbench\.(solvers|problems)\.(\w+\.)*_\w+(\.\w+)?"),
]

sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "show_signature": False,
    "show_memory": False,
    "min_reported_time": 1000,
    "write_computation_times": False,
    "remove_config_comments": True,
    "image_srcset": ["2x"],
    "abort_on_example_error": True,
    "capture_repr": ("_repr_html_", "__repr__"),
    "plot_gallery": True,
    "notebook_images": False,
    "backreferences_dir": None,
}
