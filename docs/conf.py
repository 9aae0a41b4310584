"""How the pages are built: offline, with nothing but Sphinx; numbers and pictures come from the package at build time."""

import contextlib
import io
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

import tspslam

project = "tspslam"
author = copyright = "The tspslam authors"
version = release = tspslam.__version__
language = "en-GB"

extensions = ["sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "_generated"]
default_role = "py:obj"
add_module_names = False
autodoc_typehints = "none"  # the docstrings say types, shapes and units
autodoc_member_order = "bysource"
autosummary_generate = False
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

html_theme = "alabaster"
html_title = f"tspslam {release}"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_show_sourcelink = html_show_sphinx = False
html_theme_options = {
    "description": tspslam.__doc__.splitlines()[0] if tspslam.__doc__ else "",
    "fixed_sidebar": True,
    "page_width": "1120px",
    "sidebar_width": "230px",
    "show_powered_by": False,
    "font_family": "system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif",
    "head_font_family": "system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif",
    "code_font_family": "ui-monospace, Consolas, 'DejaVu Sans Mono', monospace",
    "code_font_size": "0.86em",
}
html_sidebars = {"**": ["about.html", "navigation.html", "searchbox.html"]}


def draw_pictures(app):
    """The pictures that the tutorial shows, drawn by the package from the Motorcycle pair."""
    from tspslam.view import write_pictures

    folder = Path(app.srcdir, "_generated")
    wanted = ("keypoints_depth.png", "signals.png", "phase.png")
    if all((folder / name).exists() for name in wanted):
        return
    pair = tspslam.datasets.motorcycle()
    write_pictures(tspslam.Session(pair.rig).process(pair), folder)


def run_code_blocks(app, doctree):
    """Run the Python blocks of a page in one namespace and show below each what it prints."""
    namespace = {"__name__": "__main__"}
    for block in list(doctree.findall(nodes.literal_block)):
        if block.get("language") != "python":
            continue
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(block.astext(), app.env.docname, "exec"), namespace)
        text = printed.getvalue().rstrip()
        if text:
            output = nodes.literal_block(text, text, language="text", classes=["output"])
            block.parent.insert(block.parent.index(block) + 1, output)


def write_mathml(writer, node, *, as_block):
    """Formulas as MathML, which browsers draw themselves: no script, no network, no LaTeX."""
    writer.body.append(tex2mathml(node.astext(), as_block=as_block))
    raise nodes.SkipNode


def setup(app):
    app.connect("builder-inited", draw_pictures)
    app.connect("doctree-read", run_code_blocks)
    app.add_html_math_renderer(
        "mathml",
        (lambda writer, node: write_mathml(writer, node, as_block=False), None),
        (lambda writer, node: write_mathml(writer, node, as_block=True), None),
    )
    app.add_css_file("tspslam.css")
    return {"version": release, "parallel_read_safe": False, "parallel_write_safe": True}
