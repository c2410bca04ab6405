"""MkDocs hook that builds the site from the repository's documents, under the same paths, so their links work.

Adds the API reference and the quickstart notebook as pages. Changes no document of the repository.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter

ROOT = Path(__file__).parents[2]
NOTEBOOK = "docs/quickstart.ipynb"
API = {
    "minivla": (
        "The public API of minivla",
        ("minivla", "factory.dataset.reader", "factory.dataset.episode", "factory.dataset.torch"),
    ),
    "policies": ("Policies and environment", ("factory.eval.driving.policy", "factory.gym.env")),
    "schemas": ("Plans and episodes", ("schemas.plan", "schemas.config", "schemas.terms", "schemas.episode")),
    "extend": ("Extension points", ("workers.experts.base", "workers.render", "factory.export.base")),
}
"""Name of each page of the API reference -> title of the page and modules that it documents."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Replaces the files of `docs_dir` with the documents of the repository, and adds the generated pages."""
    site = Files([file for file in files if file.src_dir != config.docs_dir])
    for path in sorted(_documents()):
        site.append(File(path, str(ROOT), config.site_dir, config.use_directory_urls))
    for name, (title, modules) in API.items():
        text = "\n".join([f"# {title}\n", *(f"::: {module}\n" for module in modules)])
        site.append(File.generated(config, f"api/{name}.md", content=text))
    text, resources = MarkdownExporter().from_filename(str(ROOT / NOTEBOOK))
    site.append(File.generated(config, NOTEBOOK.replace(".ipynb", ".md"), content=text))
    for name, data in resources["outputs"].items():
        site.append(File.generated(config, f"docs/{name}", content=data))
    return site


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Changes links to the quickstart notebook into links to the page that is generated from it."""
    return markdown.replace("quickstart.ipynb)", "quickstart.md)")


def on_post_build(config: MkDocsConfig) -> None:
    """Checks that no page loads a script, an image or a style sheet from another server.

    Raises:
        PluginError: a page does.
    """
    for page in Path(config.site_dir).rglob("*.html"):
        found = re.search(r'src="https?://|<link[^>]*stylesheet[^>]*https?://', page.read_text(encoding="utf-8"))
        if found:
            raise PluginError(f"{page} loads a file from another server: {found.group()}")


def _documents() -> list[str]:
    folders = [path for name in ("docs", "deploy") for path in (ROOT / name).rglob("*") if path.is_file()]
    found = [*ROOT.glob("*.md"), ROOT / "CITATION.cff", *folders]
    inside = [path.relative_to(ROOT) for path in found]
    return [str(path) for path in inside if path.parts[:2] != ("docs", "site") and "__pycache__" not in path.parts]
