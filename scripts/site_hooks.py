"""What MkDocs does beside its own work: links out of docs/, the notebook as a page, examples in docstrings."""

from __future__ import annotations

import json
import logging
import posixpath
import re
import tomllib
from pathlib import Path
from urllib.parse import urlsplit

from griffe import Extension, Object
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOK = "tutorials/quickstart.ipynb"
LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)#\s:]+)(#[^)\s]+)?\)")
EXAMPLE = re.compile(r"^>>> .*(?:\n.+)*", re.MULTILINE)
# Warnings of this logger end a strict build.
log = logging.getLogger("mkdocs.hooks.site")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Take the repository's address from pyproject.toml, if it is known."""
    urls = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["urls"]
    if address := urls.get("Repository"):
        config.repo_url, config.repo_name = address, "Repository"
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the notebook as a page, which has its text and its code."""
    notebook = files.get_file_from_path(NOTEBOOK)
    assert notebook
    parts = []
    for cell in json.loads(notebook.content_string)["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
    # The first part is the title.
    links = f"[`{Path(NOTEBOOK).name}`]({Path(NOTEBOOK).name}){{ download }}"
    if config.repo_url:
        slug = urlsplit(config.repo_url).path.strip("/")
        links += f", [in Colab](https://colab.research.google.com/github/{slug}/blob/main/docs/{NOTEBOOK})"
    parts.insert(1, f"*As a notebook: {links}.*")
    files.append(File.generated(config, NOTEBOOK.replace(".ipynb", ".md"), content="\n\n".join(parts)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links to the notebook to its page, and links out of docs/ to the repository, or make them plain text."""

    def rewritten(link: re.Match[str]) -> str:
        text, target, anchor = link.groups()
        path = posixpath.normpath(posixpath.join(posixpath.dirname(page.file.src_uri), target))
        if path == NOTEBOOK and page.file.generated_by is None:
            return f"[{text}]({target.replace('.ipynb', '.md')})"
        if not path.startswith("../"):
            return link.group()
        path = path.removeprefix("../")
        if not (ROOT / path).exists():
            log.warning("%s: link to %s, which is not in the repository", page.file.src_uri, path)
        if config.repo_url:
            return f"[{text}]({config.repo_url.rstrip('/')}/blob/main/{path}{anchor or ''})"
        return f"{text} (`{path}` in the repository)"

    return LINK.sub(rewritten, markdown)


class Examples(Extension):
    """Examples in docstrings as code; Markdown would show `>>>` as quotations."""

    def on_object(self, *, obj: Object, **_: object) -> None:
        """Fence the examples of a function, class or module."""
        if obj.docstring:
            obj.docstring.value = EXAMPLE.sub(r"```pycon\n\g<0>\n```", obj.docstring.value)
