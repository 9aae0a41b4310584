"""How the pages are built: offline, by Sphinx and its theme furo; the package gives numbers and pictures."""

import contextlib
import io
import re
import sys
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.domains.python import PyClasslike
from sphinx.util.nodes import make_refnode

import tspslam

sys.path.insert(0, str(Path(__file__).parent))  # pictures.py, rooms.py, settings_page.py

project = "tspslam"
author = copyright = "The tspslam authors"
version = release = tspslam.__version__
language = "en-GB"

extensions = ["sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "_generated"]
default_role = "py:obj"
autodoc_typehints = "none"  # the docstrings say types, shapes and units
autodoc_member_order = "bysource"
autosummary_generate = False
strip_signature_backslash = True  # napoleon then keeps the last underscore of complex_
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

html_theme = "furo"  # its fonts, scripts and search are files of the pages: nothing comes from the network
html_title = f"tspslam {release}"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_show_sourcelink = html_show_sphinx = False
html_copy_source = False
COLOURS = {"color-sidebar-link-text": "var(--color-foreground-primary)"}
COLOURS["color-sidebar-link-text--top-level"] = COLOURS["color-sidebar-link-text"]
html_theme_options = {
    "light_css_variables": COLOURS | {"color-brand-primary": "#a8480a", "color-brand-content": "#1f5fbf"},
    "dark_css_variables": COLOURS | {"color-brand-primary": "#ff9a52", "color-brand-content": "#7db2ff"},
}


PACKAGE = sorted(Path(tspslam.__file__).parent.rglob("*.py"))


def draw_pictures(app):
    """The pictures that the pages show, drawn by the package when its code, or theirs, has changed."""
    import pictures
    import rooms

    from tspslam.view import write_pictures

    folder = Path(app.srcdir, "_generated")
    folder.mkdir(exist_ok=True)
    rooms.draw(folder / "rooms.svg")
    drawn = [folder / name for name in ("keypoints_depth.png", "signals.png", "phase.png", *pictures.NAMES)]
    changed = max(path.stat().st_mtime for path in (*PACKAGE, Path(pictures.__file__)))
    if all(path.exists() and path.stat().st_mtime > changed for path in drawn):
        return
    pair = tspslam.datasets.motorcycle()
    write_pictures(tspslam.Session(pair.rig).process(pair), folder)
    pictures.draw(folder)


def write_settings(app):
    """The tables of the page of settings."""
    import settings_page

    settings_page.write(Path(app.srcdir, "_generated"))


def run_code_blocks(app, doctree):
    """Run the Python blocks of a page in one namespace and show below each what it prints."""
    if app.config.run_code_of and app.env.docname not in app.config.run_code_of:
        return
    namespace = {"__name__": "__main__"}
    for path in PACKAGE:
        app.env.note_dependency(path)
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


def split_grouped_fields(app, what, name, obj, options, lines):
    """Give each of ``a, b : float`` its own entry, which napoleon does for parameters, not for attributes."""
    if what == "class":
        group = re.compile(r"^((?:\w+, )+\w+)((?: :.*)?)\n((?: +.*\n|\n(?= ))+)", re.MULTILINE)
        text = group.sub(lambda m: "".join(f"{n}{m[2]}\n{m[3]}" for n in m[1].split(", ")), "\n".join(lines) + "\n")
        lines[:] = text.splitlines()


def find_by_last_name(app, env, node, contnode):
    """Link a name that a docstring gives without its module, if only one object on the pages has it."""
    if node.get("refdomain") != "py" or not node["reftarget"].isidentifier():
        return None
    objects = env.domains["py"].objects
    found = [entry for name, entry in objects.items() if name.split(".")[-1] == node["reftarget"]]
    if len(found) != 1:
        return None
    return make_refnode(app.builder, node["refdoc"], found[0].docname, found[0].node_id, contnode)


def level_captions(app, pagename, templatename, context, doctree):
    """Captions of the table of contents are headings; a screen reader wants to know of which level."""
    tree = context.get("furo_navigation_tree", "")
    context["furo_navigation_tree"] = tree.replace('role="heading"', 'role="heading" aria-level="2"')


def setup(app):
    for field in PyClasslike.doc_field_types:
        field.label = "Attributes" if field.name == "variable" else field.label
    app.add_config_value("run_code_of", [], "env")  # pages; none: all
    app.connect("autodoc-process-docstring", split_grouped_fields, priority=400)
    app.connect("missing-reference", find_by_last_name)
    app.connect("builder-inited", draw_pictures)
    app.connect("builder-inited", write_settings)
    app.connect("doctree-read", run_code_blocks)
    app.connect("html-page-context", level_captions, priority=900)  # after the theme
    app.add_html_math_renderer(
        "mathml",
        (lambda writer, node: write_mathml(writer, node, as_block=False), None),
        (lambda writer, node: write_mathml(writer, node, as_block=True), None),
    )
    app.add_css_file("tspslam.css")
    return {"version": release, "parallel_read_safe": False, "parallel_write_safe": True}
