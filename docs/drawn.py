"""Keep the figure that the last line of an example returns, for the gallery."""

import ast
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

DOTS_PER_INCH = 130


def drawn(block, block_vars, gallery_conf):
    """Save the figure of a block and return the text that shows it; an image scraper of Sphinx-Gallery."""
    found = block_vars["example_globals"].get("___")
    figure = found.figure.figure if isinstance(found, Axes) else found
    if not isinstance(figure, Figure):
        return ""
    path = next(block_vars["image_path_iterator"])
    figure.savefig(path, dpi=DOTS_PER_INCH)
    words = ast.get_docstring(ast.parse(Path(block_vars["src_file"]).read_text("utf-8")))
    title = words.splitlines()[0]
    return figure_rst([path], gallery_conf["src_dir"], title)
