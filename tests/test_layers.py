"""The architecture: which package may import which, and through which names."""

import ast
import importlib
import tomllib
from pathlib import Path

import pytest
from conftest import PROJECT

import nfbench

LAYERS = [  # from the bottom; a package imports from layers below its own, and from no other package of its layer
    {"core"},
    {"plugins"},
    {"study"},
    {"analysis"},
    {"results"},
    {"execution"},
    {"figures", "report", "tuning", "testing"},
    {"cli"},
]
LEVEL = {package: level for level, packages in enumerate(LAYERS) for package in packages}
FRAMEWORK = sorted((PROJECT / "nfbench").rglob("*.py"))
PLUGINS = sorted([*(PROJECT / "problems").rglob("*.py"), *(PROJECT / "solvers").rglob("*.py")])


def imports(path, package):
    """(module, names, line) of each import statement of a file, relative ones resolved within ``package``."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, [], node.lineno
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            base = parts[: len(parts) - node.level + 1] if node.level else []
            yield ".".join([*base, *([node.module] if node.module else [])]), [a.name for a in node.names], node.lineno


def module_of(path):
    """The dotted package that holds a file, e.g. ``nfbench.study`` or ``nfbench.problems.near_field``."""
    parts = path.relative_to(PROJECT).parent.parts
    return ".".join(parts if parts[0] == "nfbench" else ("nfbench", *parts))


def own(path):
    """What a file imports of nfbench: (module, names, where it stands)."""
    for module, names, line in imports(path, module_of(path)):
        if module.partition(".")[0] == "nfbench":
            yield module, names, f"{path.relative_to(PROJECT)}:{line}"


def test_every_package_has_its_layer():
    packages = {path.name for path in (PROJECT / "nfbench").iterdir() if (path / "__init__.py").is_file()}
    assert packages == set(LEVEL)
    assert {path.name for path in (PROJECT / "nfbench").glob("*.py")} == {"__init__.py", "__main__.py"}


@pytest.mark.parametrize("path", [p for p in FRAMEWORK if p.parent.name != "nfbench"], ids=lambda p: str(p.name))
def test_imports_go_down_and_through_the_list_of_the_other_package(path):
    here = path.relative_to(PROJECT / "nfbench").parts[0]
    for module, names, where in own(path):
        parts = module.split(".")
        if module == "nfbench":
            assert names == ["__version__"], f"{where}: import from the package that defines it, not from nfbench"
            continue
        assert parts[1] not in ("problems", "solvers"), f"{where}: the framework never imports its plugins"
        if parts[1] == here:
            continue
        assert LEVEL[parts[1]] < LEVEL[here], f"{where}: {here} is not above {parts[1]}"
        assert len(parts) == 2, f"{where}: import from nfbench.{parts[1]}, not from its module {module}"
        hidden = set(names) - set(importlib.import_module(module).__all__)
        assert not hidden, f"{where}: {hidden} are private to {module}"


@pytest.mark.parametrize("path", PLUGINS, ids=lambda p: str(p.name))
def test_plugins_use_the_public_api_alone(path):
    here = "nfbench." + path.relative_to(PROJECT).parts[0]
    for module, names, where in own(path):
        if not module.startswith(here):
            assert module == "nfbench", f"{where}: a plugin imports from nfbench itself, not from {module}"
            assert set(names) <= set(nfbench.__all__), f"{where}: {set(names) - set(nfbench.__all__)} are not public"


def test_imports_never_come_back_to_where_they_started():
    """Modules of one package have an order, too: following their imports never leads back."""
    files = {}
    for path in [*FRAMEWORK, *PLUGINS]:
        package = module_of(path)
        files[package if path.name == "__init__.py" else f"{package}.{path.stem}"] = path
    graph = {}
    for module, path in files.items():
        named = {each for target, names, _ in own(path) for each in [target, *(f"{target}.{name}" for name in names)]}
        graph[module] = (named & set(files)) - {module, module_of(path), "nfbench"}
    done = set()

    def follow(module, path):
        assert module not in path, f"imports in a circle: {' → '.join([*path[path.index(module) :], module])}"
        if module not in done:
            for target in graph[module]:
                follow(target, [*path, module])
            done.add(module)

    for module in graph:
        if module != "nfbench":
            follow(module, [])


@pytest.mark.parametrize("name", nfbench.__all__)
def test_every_public_name_can_be_imported_and_is_no_module(name):
    found = getattr(nfbench, name)
    assert not hasattr(found, "__path__") and type(found).__name__ != "module"


def test_every_package_is_installed():
    packages = tomllib.loads((PROJECT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    assert set(packages) == {module_of(path) for path in [*FRAMEWORK, *PLUGINS] if path.name == "__init__.py"}


def test_files_and_functions_stay_short():
    for path in [*FRAMEWORK, *PLUGINS]:
        text = path.read_text(encoding="utf-8")
        assert text.count("\n") <= 400, f"{path.relative_to(PROJECT)} has over 400 lines"
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines = node.end_lineno - node.lineno + 1
                assert lines <= 60, f"{Path(path).name}:{node.lineno}: {node.name} has {lines} lines"
