"""The words that `docs/glossary.md` lists as not used, in brackets."""

import ast
import functools
import inspect
import re
from pathlib import Path

import erosion
from erosion import models, ode

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "erosion"
GLOSSARY = ROOT / "docs" / "glossary.md"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md"), *ROOT.glob("docs/develop/*.md")]


def unused_words():
    words = "|".join(re.findall(r"\(not: ([^)]+)\)$", GLOSSARY.read_text("utf-8"), re.MULTILINE)).replace(", ", "|")
    return re.compile(rf"\b({words})(s|es)?\b", re.IGNORECASE)


CODE_AND_LINKS = re.compile(r"^```.*?^```|`[^`\n]*`|\]\([^)]*\)", re.MULTILINE | re.DOTALL)


def words_of_name(name):
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).replace("_", " ")


def public_objects():
    for module in (erosion, models, ode):
        for name in dir(module):
            value = getattr(module, name)
            if not name.startswith("_") and getattr(value, "__module__", "").startswith("erosion"):
                yield name, value
                for member, method in inspect.getmembers(value if inspect.isclass(value) else None):
                    if not member.startswith("_") and getattr(method, "__module__", "").startswith("erosion"):
                        yield f"{name}.{member}", method


@functools.cache
def nodes():
    """Those of each module's syntax tree, by its path."""
    return {module: [*ast.walk(ast.parse(module.read_text("utf-8")))] for module in PACKAGE.rglob("*.py")}


def names_of(module):
    """Of classes, functions, arguments, variables and attributes, private ones too."""
    for node in nodes()[module]:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.id if isinstance(node, ast.Name) else node.attr


def test_words_are_found():
    found = unused_words().search("The optimal angles")
    assert found
    assert found[1] == "optimal angle"


def test_pages_use_the_words_of_the_glossary():
    unused = unused_words()
    for page in PAGES:
        if page != GLOSSARY:
            text = CODE_AND_LINKS.sub("", page.read_text("utf-8"))
            assert not [found[0] for found in unused.finditer(text)], page.name


def test_public_names_and_their_docstrings_use_the_words_of_the_glossary():
    unused = unused_words()
    for name, value in public_objects():
        first_line = (value.__doc__ or "").strip().partition("\n")[0]
        parameters = inspect.signature(value).parameters if inspect.isroutine(value) else ()
        for text in (*map(words_of_name, (name, *parameters)), first_line):
            assert not unused.search(text), name


# Words of users' tables and of another library.
OTHERS_WORDS = {"tables/headings.py", "fits/tables.py", "lanes/jax_versions.py"}


def strings_of(module):
    """Docstrings and messages."""
    return [node.value for node in nodes()[module] if isinstance(node, ast.Constant) and isinstance(node.value, str)]


def test_docstrings_and_messages_use_the_words_of_the_glossary():
    unused = unused_words()
    assert {path for path in OTHERS_WORDS if (PACKAGE / path).is_file()} == OTHERS_WORDS
    texts = {
        module: strings_of(module) for module in nodes() if module.relative_to(PACKAGE).as_posix() not in OTHERS_WORDS
    } | {page: [page.read_text("utf-8")] for page in (*PACKAGE.rglob("*.md"), PACKAGE / "results" / "findings.toml")}
    found = [(file.name, word[0]) for file in texts for text in texts[file] for word in unused.finditer(text)]
    assert not found


def test_names_use_the_words_of_the_glossary():
    unused = unused_words()
    found = {
        (module.name, name) for module in nodes() for name in names_of(module) if unused.search(words_of_name(name))
    }
    assert not found


def test_each_class_has_a_name_of_its_own():
    classes = [node.name for module in nodes().values() for node in module if isinstance(node, ast.ClassDef)]
    assert not {name for name in classes if classes.count(name) > 1}
