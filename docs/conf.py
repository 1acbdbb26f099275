"""Sphinx configuration; neither the build nor the pages need a network."""

import functools
import importlib
import logging
import re
import sys
from importlib import metadata
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.ext.napoleon import GoogleDocstring

sys.path.insert(0, str(Path(__file__).parent))
from studies import run_studies

logging.getLogger().addHandler(logging.NullHandler())  # or the style of the code would have all of INFO printed

project = "strandline"
author = "strandline contributors"
copyright = "2026, strandline contributors"
release = metadata.version("strandline")

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_gallery.gen_gallery"]
exclude_patterns = ["_build", "gallery", "built/gallery/**/*.ipynb"]
html_theme = "furo"
smartquotes_action = "qe"  # options keep their dashes
html_title = f"strandline {release}"
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["site.js"]
html_math_renderer = "mathml"
default_role = "code"

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "built/gallery",
    "ignore_pattern": r"studies/",
    "image_scrapers": ("drawn.drawn",),
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1000,
    "remove_config_comments": True,
    "write_computation_times": False,
}

autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
napoleon_numpy_docstring = False
napoleon_use_ivar = True


def inline_math(self, node):
    self.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def block_math(self, node):
    self.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


REFERENCE = Path(__file__).parent / "reference"
MODULES = re.findall(r"^api/(\S+)$", (REFERENCE / "python.md").read_text("utf-8"), re.MULTILINE)
SEVERAL = ("answer", "what_if", "next", "coverage", "compare", "specimens", "opened", "specimen", "population", "many")
FURTHER = {"questions": [f"questions.{name}" for name in SEVERAL]}
"""Modules on the page of another one."""
ELSEWHERE = {"runs.executors": "Executor, InProcess, LocalProcesses"}
"""Names that the page of another module describes."""
ATTRIBUTES = ("attribute", "data", "property")
kept = {}


def write_api(app):
    """Write the pages that reference/python.md lists, one for each module, where they are not so already."""
    folder = REFERENCE / "api"
    folder.mkdir(exist_ok=True)
    for path in folder.glob("*.md"):
        if path.stem not in MODULES:
            path.unlink()
    for name in MODULES:
        module = importlib.import_module(f"strandline.{name}")
        vars(module).update({one: getattr(module, one) for one in getattr(module, "__all__", ())})  # from behind a door
        lines = [f".. automodule:: strandline.{module}" for module in (name, *FURTHER.get(name, ()))]
        if name in ELSEWHERE:
            lines.append(f"   :exclude-members: {ELSEWHERE[name]}")
        text = "\n".join([f"# strandline.{name}\n", "```{eval-rst}", *lines, "```\n"])
        path = folder / f"{name}.md"
        if not path.is_file() or path.read_text("utf-8") != text:
            path.write_text(text, encoding="utf-8")


def require_content(app, exception):
    """Refuse a page of the API that describes nothing."""
    pages = [] if exception else (Path(app.outdir) / "reference" / "api").glob("*.html")
    empty = [page.stem for page in pages if page.stem in MODULES and "sig-object" not in page.read_text("utf-8")]
    if empty:
        raise ValueError(f"pages of the API that describe nothing: {', '.join(empty)}")


def linked(piece):
    """Return a public name in backticks as a link to where it is described; anything else as it is."""
    full = public_names().get(piece.strip("`"))
    return f":py:obj:`~{full}`" if full and re.fullmatch("`[^`]+`", piece) else piece


@functools.cache
def public_names():
    """Return the full name of everything that the pages of the API describe."""
    found = {}
    for module in (importlib.import_module(f"strandline.{name}") for name in sorted(MODULES)):
        names = getattr(module, "__all__", None) or [name for name in vars(module) if name[0].isupper()]
        found.update({name: f"{module.__name__}.{name}" for name in names})
    return found


def before_napoleon(app, what, name, obj, options, lines):
    """Escape what RST would read as markup (|x|, a trailing _, a lone *): docstrings are prose with `code`.

    Napoleon takes the first words of a property's docstring, up to a colon, for a type; so it gets none to see.
    """
    for number, line in enumerate(lines):
        pieces = [linked(piece) for piece in re.split(r"(``.*?``|`.*?`)", line)]
        pieces[::2] = [re.sub(r"([|*]|_(?=\W|$))", r"\\\1", piece) for piece in pieces[::2]]
        lines[number] = "".join(pieces)
    if what in ATTRIBUTES:
        kept[name] = GoogleDocstring(list(lines), app.config, app, "method", name, obj, options).lines()
        lines.clear()


def after_napoleon(app, what, name, obj, options, lines):
    if what in ATTRIBUTES:
        lines[:] = kept.pop(name, [])


def setup(app):
    app.connect("builder-inited", run_studies, priority=100)
    app.connect("builder-inited", write_api)
    app.connect("build-finished", require_content)
    app.add_html_math_renderer("mathml", (inline_math, None), (block_math, None))
    app.connect("autodoc-process-docstring", before_napoleon, priority=300)
    app.connect("autodoc-process-docstring", after_napoleon, priority=700)
