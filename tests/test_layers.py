"""The architecture: which package may import which, and through which names."""

import ast
import importlib
import tomllib
from pathlib import Path

import pytest
from conftest import PROJECT

import nfbench

LAYERS = [  # from the bottom; a package may import only from layers below its own
    {"core"},
    {"plugins"},
    {"study"},
    {"analysis"},
    {"results"},
    {"execution"},
    {"figures", "tuning", "testing"},
    {"report"},
    {"cli"},
]
LEVEL = {package: level for level, packages in enumerate(LAYERS) for package in packages}
FRAMEWORK = sorted((PROJECT / "nfbench").rglob("*.py"))
PLUGINS = sorted([*(PROJECT / "problems").rglob("*.py"), *(PROJECT / "solvers").rglob("*.py")])


def imports(path, package):
    """Yield (module, names, line) of each import statement; relative ones are resolved in ``package``."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, [], node.lineno
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            base = parts[: len(parts) - node.level + 1] if node.level else []
            yield ".".join([*base, *([node.module] if node.module else [])]), [a.name for a in node.names], node.lineno


def module_of(path):
    """The dotted package that contains a file, e.g. ``nfbench.study`` or ``nfbench.problems.near_field``."""
    parts = path.relative_to(PROJECT).parent.parts
    return ".".join(parts if parts[0] == "nfbench" else ("nfbench", *parts))


def own_imports(path):
    """Yield (module, names, location) of each import from nfbench in a file."""
    for module, names, line in imports(path, module_of(path)):
        if module.partition(".")[0] == "nfbench":
            yield module, names, f"{path.relative_to(PROJECT)}:{line}"


def test_every_package_has_a_layer():
    packages = {path.name for path in (PROJECT / "nfbench").iterdir() if (path / "__init__.py").is_file()}
    assert packages == set(LEVEL)
    assert {path.name for path in (PROJECT / "nfbench").glob("*.py")} == {"__init__.py", "__main__.py"}


@pytest.mark.parametrize("path", [p for p in FRAMEWORK if p.parent.name != "nfbench"], ids=lambda p: str(p.name))
def test_imports_go_to_lower_layers_and_use_only_public_names(path):
    package = path.relative_to(PROJECT / "nfbench").parts[0]
    for module, names, where in own_imports(path):
        parts = module.split(".")
        if module == "nfbench":
            assert names == ["__version__"], f"{where}: import from the package that defines it, not from nfbench"
            continue
        assert parts[1] not in ("problems", "solvers"), f"{where}: the framework never imports its plugins"
        if parts[1] == package:
            continue
        assert LEVEL[parts[1]] < LEVEL[package], f"{where}: {package} is not above {parts[1]}"
        assert len(parts) == 2, f"{where}: import from nfbench.{parts[1]}, not from its module {module}"
        hidden = set(names) - set(importlib.import_module(module).__all__)
        assert not hidden, f"{where}: {hidden} are private to {module}"


@pytest.mark.parametrize("path", PLUGINS, ids=lambda p: str(p.name))
def test_plugins_use_only_the_public_api(path):
    package = "nfbench." + path.relative_to(PROJECT).parts[0]
    for module, names, where in own_imports(path):
        if not module.startswith(package):
            assert module == "nfbench", f"{where}: a plugin imports from nfbench itself, not from {module}"
            assert set(names) <= set(nfbench.__all__), f"{where}: {set(names) - set(nfbench.__all__)} are not public"


def test_there_are_no_circular_imports():
    """Not even the modules of one package import each other in a circle."""
    files = {}
    for path in [*FRAMEWORK, *PLUGINS]:
        package = module_of(path)
        files[package if path.name == "__init__.py" else f"{package}.{path.stem}"] = path
    graph = {}
    for module, path in files.items():
        named = set()
        for target, names, _ in own_imports(path):
            named |= {target, *(f"{target}.{name}" for name in names)}
        graph[module] = (named & set(files)) - {module, module_of(path), "nfbench"}
    done = set()

    def follow(module, path):
        assert module not in path, f"circular import: {' → '.join([*path[path.index(module) :], module])}"
        if module not in done:
            for target in graph[module]:
                follow(target, [*path, module])
            done.add(module)

    for module in graph:
        if module != "nfbench":
            follow(module, [])


@pytest.mark.parametrize("name", nfbench.__all__)
def test_every_public_name_can_be_imported_and_is_not_a_module(name):
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
