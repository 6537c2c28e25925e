"""The names that `erosion` offers."""

import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import erosion
from erosion import impacts, parameters
from erosion.cli import lazy

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("name", dir(erosion))
def test_a_public_name_is_listed_where_it_is_defined(name):
    value = getattr(erosion, name)
    module = getattr(value, "__module__", None)
    if module is None or name.isupper():  # a module or a constant says nothing of its own
        return
    assert module.startswith(vars(erosion)["_MODULE_OF"][name])


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'erosion' has no attribute 'alphamax'"):
        getattr(erosion, "alphamax")  # noqa: B009


def test_importing_the_package_loads_neither_jax_nor_numpy():
    code = "import sys, erosion; sys.exit('jax' in sys.modules or 'numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_every_name_is_documented():
    text = (ROOT / "docs" / "api.md").read_text()
    missing = [name for name in dir(erosion) if not re.search(rf"\b{name}\b", text)]
    assert missing == ["__version__"]


def names_in_docs():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    text = "".join(page.read_text("utf-8") for page in pages)
    return sorted({*re.findall(r"\berosion\.[a-z]\w*\.\w+(?:\.\w+)*", text)})


@pytest.mark.parametrize("name", names_in_docs())
def test_a_name_in_the_docs_exists(name):
    assert pkgutil.resolve_name(name) is not None


def listed(module):
    stub = Path(f"{module.__file__}i").read_text("utf-8")
    return re.findall(r"^from \S+ import (\w+) as \1$", stub, re.MULTILINE)


def test_what_the_verbs_import_lazily_is_there_and_used():
    verbs = "".join(module.read_text() for module in Path(lazy.__file__).parent.glob("*.py"))
    for name in listed(lazy):
        assert hasattr(lazy, name)
        assert re.search(rf"lazy\.{name}\b|^    {name}: ", verbs, re.MULTILINE), name


@pytest.mark.parametrize("room", [parameters, impacts])
def test_what_a_room_lists_is_there_and_used(room):
    folder = Path(room.__file__).parent
    others = "".join(file.read_text() for file in folder.parent.rglob("*.py") if file.parent != folder)
    for name in listed(room):
        assert hasattr(room, name)
        assert re.search(rf"\b{name}\b", others), name
