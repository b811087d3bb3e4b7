"""The cache of compiled functions on disk: what is loaded from it is what the sources say now, in every file."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

HELPER = """
from nfbench import compiled
@compiled()
def scale(x):
    return {factor} * x
"""
CALLER = """
from numba import types
from nfbench import compiled, load_kernels
{imports}
@compiled()
def twice(x):
    return scale(x) + scale(x)
load_kernels([(twice, (types.float64,))], "compiling")
"""
RUN = "from {module} import twice; print(twice(1.0), len(twice.stats.cache_hits), twice.stats.cache_path)"
ENVIRONMENT = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}


class Package:
    """Two modules, of which ``caller`` imports a kernel from ``helper``; every run is a new process."""

    def __init__(self, folder: Path, imports: str, helper: Path, module: str):
        self.folder, self.helper, self.module = folder, helper, module
        for file in (helper, folder / f"{module.replace('.', '/')}.py"):
            file.parent.mkdir(parents=True, exist_ok=True)
        (folder / f"{module.replace('.', '/')}.py").write_text(CALLER.format(imports=imports))

    def write(self, factor: float) -> None:
        self.helper.write_text(HELPER.format(factor=factor))

    def run(self, before: str = "", **environment: str) -> tuple[float, bool, Path]:
        """The value, whether it was loaded without compiling, and the folder."""
        done = subprocess.run(
            [sys.executable, "-c", textwrap.dedent(before) + RUN.format(module=self.module)],
            cwd=self.folder,
            env={**ENVIRONMENT, "PYTHONDONTWRITEBYTECODE": "1", **environment},
            capture_output=True,
            text=True,
            check=True,
        )
        value, hits, path = done.stdout.split(maxsplit=2)
        return float(value), hits == "1" and done.stderr == "", Path(path.strip())


def one_package(tmp_path: Path) -> Package:
    package = Package(tmp_path, "from .helper import scale", tmp_path / "pack" / "helper.py", "pack.caller")
    (tmp_path / "pack" / "__init__.py").touch()
    return package


def two_packages(tmp_path: Path) -> Package:
    package = Package(tmp_path, "from other.helper import scale", tmp_path / "other" / "helper.py", "pack.caller")
    (tmp_path / "pack" / "__init__.py").touch()
    (tmp_path / "other" / "__init__.py").touch()
    return package


def lone_files(tmp_path: Path) -> Package:
    """As plugin files are: in no package."""
    return Package(tmp_path, "import helper\nscale = helper.scale", tmp_path / "helper.py", "caller")


@pytest.mark.parametrize("make", [one_package, two_packages, lone_files])
def test_a_change_of_an_imported_kernel_is_compiled_and_no_change_is_loaded(tmp_path, make):
    package = make(tmp_path)
    package.write(1.5)
    value, loaded, folder = package.run()
    assert (value, loaded) == (3.0, False)
    assert folder.parent == (tmp_path / "pack" if make is not lone_files else tmp_path) / "__pycache__"
    assert package.run() == (3.0, True, folder)
    package.write(2.5)
    value, loaded, another = package.run()
    assert (value, loaded) == (5.0, False)
    assert another != folder


def test_numba_alone_runs_stale_code(tmp_path):
    """What the key is for; if this fails, Numba follows imports and the key can go."""
    package = one_package(tmp_path)
    constant_key = "import nfbench.core.jit as jit; jit._key = lambda function: 'constant'\n"
    package.write(1.5)
    assert package.run(constant_key)[0] == 3.0
    package.write(2.5)
    assert package.run(constant_key)[0] == 3.0


def test_another_compiler_or_processor_has_a_folder_of_its_own(tmp_path):
    package = one_package(tmp_path)
    package.write(1.5)
    _, _, folder = package.run()
    for other in (
        "import numba; numba.__version__ = '0.0'",
        "import llvmlite; llvmlite.__version__ = '0.0'",
        "from numba.core.registry import cpu_target; codegen = type(cpu_target.target_context.codegen())\n"
        "codegen.magic_tuple = lambda self: ('x86', 'another', '+none')",
    ):
        value, loaded, another = package.run(other + "\n")
        assert (value, loaded) == (3.0, False)
        assert another != folder
        assert another.parent == folder.parent
    assert package.run() == (3.0, True, folder)


def test_the_few_folders_that_were_used_last_are_kept(tmp_path):
    package = one_package(tmp_path)
    package.write(1.5)
    _, _, used = package.run()
    caches = used.parent
    os.utime(used, (1, 1))  # the oldest, until the next run
    for age in range(6):
        (caches / f"caller.nfbench-{age}").mkdir()
        os.utime(caches / f"caller.nfbench-{age}", (100 - age, 100 - age))
    (caches / "callers.nfbench-0").mkdir()
    assert package.run() == (3.0, True, used)
    package.write(2.5)
    _, _, new = package.run()
    kept = {path.name for path in caches.iterdir() if path.name.startswith("caller")}
    assert kept == {new.name, used.name, "caller.nfbench-0", "caller.nfbench-1", "callers.nfbench-0"}


def test_numba_cache_dir_comes_first(tmp_path):
    package = one_package(tmp_path)
    package.write(1.5)
    chosen = {"NUMBA_CACHE_DIR": str(tmp_path / "chosen")}
    assert package.run(**chosen)[2].is_relative_to(tmp_path / "chosen")
    assert package.run(**chosen)[1]
    package.write(2.5)
    assert package.run(**chosen)[:2] == (5.0, False)
    assert not (tmp_path / "pack" / "__pycache__").exists()


def test_a_read_only_package_has_its_cache_in_the_users_folder(tmp_path):
    package = one_package(tmp_path)
    (tmp_path / "pack" / "__pycache__").write_text("no folder can be made here, not even by root")
    package.write(1.5)
    home = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    value, loaded, folder = package.run(**home)
    assert (value, loaded) == (3.0, False)
    assert folder.is_relative_to(tmp_path / "cache")
    assert package.run(**home) == (3.0, True, folder)
    package.write(2.5)
    assert package.run(**home)[:2] == (5.0, False)


def test_locators_that_the_user_names_are_keyed_too(tmp_path):
    from numba.core import config

    if not hasattr(config, "CACHE_LOCATOR_CLASSES"):
        return  # an older Numba
    package = one_package(tmp_path)
    locators = {
        "NUMBA_CACHE_LOCATOR_CLASSES": "UserWideCacheLocator",
        "HOME": str(tmp_path),
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
    }
    package.write(1.5)
    assert package.run(**locators)[2].is_relative_to(tmp_path / "cache")
    package.write(2.5)
    assert package.run(**locators)[:2] == (5.0, False)


def test_where_no_folder_is_writable_the_error_says_what_to_do(tmp_path):
    package = one_package(tmp_path)
    package.write(1.5)
    for folder in (tmp_path / "pack" / "__pycache__", tmp_path / "cache"):
        folder.write_text("no folder can be made here, not even by root")
    code = (
        "from nfbench import NfbenchError\n"
        "try:\n    import pack.caller\n"
        "except NfbenchError as error:\n    print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**ENVIRONMENT, "HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "set NUMBA_CACHE_DIR to a writable folder" in done.stdout


def test_several_processes_may_start_at_once(tmp_path):
    package = one_package(tmp_path)
    package.write(1.5)
    package.run()
    package.write(2.5)
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", RUN.format(module="pack.caller")],
            cwd=tmp_path,
            env=ENVIRONMENT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(3)
    ]
    outputs = [process.communicate() for process in processes]
    assert [process.returncode for process in processes] == [0] * 3
    assert {output.split()[0] for output, _ in outputs} == {"5.0"}
    assert package.run()[:2] == (5.0, True)


@pytest.mark.parametrize(
    "damage", ["truncated", "flipped", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("empty", "text"))]
)
@pytest.mark.parametrize("suffix", [".nbc", ".nbi"])
def test_a_damaged_cache_is_compiled_again(tmp_path, suffix, damage):
    package = one_package(tmp_path)
    package.write(2.0)
    _, _, folder = package.run()
    for file in folder.glob(f"*{suffix}"):
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 0xFF
        half = bytes(content[: len(content) // 2])
        file.write_bytes({"empty": b"", "truncated": half, "flipped": bytes(content), "text": b"hello"}[damage])
    value, loaded, _ = package.run()
    assert value == 4.0 and not loaded
    value, loaded, _ = package.run()
    assert value == 4.0 and loaded


def test_where_the_cache_cannot_be_written_again_the_folder_is_named(tmp_path):
    package = one_package(tmp_path)
    package.write(2.0)
    _, _, folder = package.run()
    for file in [*folder.glob("*.nbi")]:
        file.unlink()
        file.mkdir()
        (file / "in-the-way").touch()
    with pytest.raises(subprocess.CalledProcessError) as error:
        package.run()
    assert f"compiled code is kept in {folder}" in error.value.stderr


MANY = """
import os
from numba import types
from nfbench import compiled, load_kernels
{start}
@compiled()
def f0(x):
    return x
@compiled()
def f1(x):
    return f0(x) + 1.0
@compiled()
def f2(x):
    return f1(x) * f1(x)
@compiled()
def f3(x):
    return f2(x) + f0(x)
@compiled()
def f4(x):
    return f3(x) * 2.0
parent, kernels = os.getpid(), [f0, f1, f2, f3, f4]
load_kernels([(kernel, (types.float64,)) for kernel in kernels], "compiling")
try:
    children = os.waitpid(-1, os.WNOHANG)
except ChildProcessError:
    children = "none"
hits = sum(len(kernel.stats.cache_hits) for kernel in kernels)
print(os.getpid() == parent, [kernel(2.0) for kernel in kernels], hits, children)
"""


@pytest.mark.parametrize(
    "start",
    [
        "",
        "fork = os.fork; os.fork = lambda: fork() or os._exit(1)",  # the second process dies at once
        "os.sched_getaffinity = lambda pid: {0}",
    ],
    ids=["two processes", "the second one dies", "one processor"],
)
def test_many_kernels_are_all_compiled_once_and_no_process_remains(tmp_path, start):
    for hits in (None, "5"):
        (tmp_path / "many.py").write_text(MANY.format(start=start))
        done = subprocess.run(
            [sys.executable, "-c", "import many"], cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        words = done.stdout.strip().rsplit(maxsplit=2)
        assert words[0] == "True [2.0, 3.0, 9.0, 11.0, 22.0]" and words[2] == "none", done.stdout
        assert hits is None or (words[1] == hits and done.stderr == "")


PRODUCTS = """
import sys
from numba import types
from nfbench import compiled
@compiled({"contract"})
def fused(z, w):
    return z * w
@compiled()
def plain(z, w):
    return z * w
for name in sys.argv[1:]:
    kernel = globals()[name]
    kernel.compile((types.complex128, types.complex128))
z, w = 0.1 + 0.7j, 0.3 - 0.9j
print(*(kernel(z, w) for kernel in (fused, plain)))
"""


@pytest.mark.parametrize("order", [["fused", "plain"], ["plain", "fused"]])
def test_a_complex_product_has_the_options_of_its_own_kernel(tmp_path, order):
    """Numba compiles it once per process, with the options of the kernel that needs it first."""
    (tmp_path / "products.py").write_text(PRODUCTS)
    done = subprocess.run(
        [sys.executable, "products.py", *order],
        cwd=tmp_path,
        env={**ENVIRONMENT, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    fused, plain = map(complex, done.stdout.split())
    z, w = 0.1 + 0.7j, 0.3 - 0.9j
    assert plain == z * w  # Python's products are rounded one by one
    assert fused != plain and abs(fused - plain) < 1e-15


ASSEMBLY = """
from nfbench.problems.near_field.objectives import kernels
[(kernel, signature)] = [entry for entry in kernels._SIGNATURES if entry[0] is kernels.misfit]
kernel.compile(signature)
print(kernel.overloads[signature].library.get_asm_str())
"""


def test_the_machine_code_of_a_kernel_is_complete(tmp_path):
    """Otherwise a function that it shares with other kernels is that of the kernel that was loaded first."""
    done = subprocess.run(
        [sys.executable, "-c", ASSEMBLY],
        env={**ENVIRONMENT, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    shared = {line.split()[1] for line in done.stdout.splitlines() if line.split()[:1] == [".weak"]}
    assert shared <= {"NRT_incref", "NRT_decref"}  # of Numba's memory management
