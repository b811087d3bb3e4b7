"""Manifests that are wrong on purpose, and random changes of valid ones, for the tests and for ``python hostile.py``.

As a script it loads random manifests in a process whose memory is limited, and prints the violations as JSON.
"""

# ruff: noqa: E501  # one line per case

import json
import random
import resource
import sys
import time
from pathlib import Path

VALID = """name = "s"
repetitions = 2
seed = 1
[scenario]
kind = "near-field"
array = { kind = "ula", elements = 16, spacing_wavelengths = 0.25, origin = "first" }
wavelength_m = 0.02
sources = 2
snapshots = 20
snr_db = 20.0
azimuth_deg = [-60, 60]
range_m = [0.05, 0.2]
[[formulation]]
kind = "nemo"
[[solver]]
kind = "de"
[budget]
evaluations = 100
"""
SECONDS, MEGABYTES = 2.0, 500


def with_(old, new):
    """The valid manifest with one line or value replaced."""
    assert VALID.count(old) == 1, old
    return VALID.replace(old, new)


def custom(options):
    return with_('kind = "ula", elements = 16, spacing_wavelengths = 0.25', f'kind = "custom", {options}')


def many(table, count, line="x{} = 1"):
    """The valid manifest with ``count`` more lines in a table."""
    return with_(table, table + "\n" + "\n".join(line.format(i) for i in range(count)))


REFUSED = {  # name: (manifest, parts of the message)
    # nesting, numbers, keys: what tomllib takes long for or fails on
    "2,000 nested brackets": (VALID + "x = " + "[" * 2000 + "]" * 2000, "at most 32 nested brackets, got more in line 19"),
    "2,000 nested tables": (VALID + "x = " + "{a=" * 2000 + "1" + "}" * 2000, "at most 32 nested brackets"),
    "unclosed brackets": ("[" * 100_000, "at most 32 nested brackets, got more in line 1"),
    "nested tables by dotted keys": (VALID + "\n[" + "].[".join("a" * 3000) + "]", "line"),
    "an integer of 5,000 digits": (with_("= 100", "= " + "9" * 5000), "64-bit numbers, got 5,000 characters in line 18"),
    "a hexadecimal integer": (with_("= 100", "= 0x" + "f" * 5000), "64-bit numbers"),
    "a hexadecimal integer of 900 digits": (with_("= 100", "= 0x" + "f" * 900), "got one of 3600 bits"),
    "a fraction of 5,000 digits": (with_("= 100", "= 0." + "1" * 5000), "64-bit numbers"),
    "a key of 20,000 dots": (VALID + ".".join("a" * 20_001) + " = 1", "at most 16 parts of a key"),
    "a quoted key of 20,000 dots": (VALID + "[sweep]\n'" + "." * 20_000 + "' = [1]", "at most 200 characters, got one of 20,000"),
    "a key of 20,000 quoted parts": (VALID + ".".join(["'a'"] * 20_001) + " = 1", "at most 16 parts"),
    "a header of 20,000 dots": (VALID + "[" + ".".join("a" * 20_001) + "]", "at most 16 parts"),
    "a short key of many dots": (VALID + "[sweep]\n'" + "." * 30 + "' = [1]", "at most 16 parts, got 31"),
    # many of anything
    "20,000 unknown keys": (many("sources = 2", 20_000), "scenario.x0: unknown option", "… and 19,950 more (the first 50 of 20,000"),
    "20,000 unknown limits": (many("evaluations = 100", 20_000), "… and 19,950 more"),
    "20,000 wrong values": (with_("snr_db = 20.0", f"snr_db = {['x'] * 20_000}"), "scenario.snr_db[0]: expected number, got 'x'", "… and 19,950 more"),
    "20,000 times nan": (with_("snr_db = 20.0", f"snr_db = [{'nan, ' * 20_000}]"), "scenario.snr_db[0]: expected a number, got nan", "… and 19,950 more"),
    "20,000 solvers": (VALID + "[[solver]]\nkind = 'x'\n" * 20_000, "at most 1,000 [[solver]] tables, got 20,001"),
    "20,000 methods": (VALID + "[[method]]\nformulation = 'x'\n" * 20_000, "at most 1,000 [[method]] tables, got 20,000"),
    "990 unknown solvers": (VALID + "".join(f"[[solver]]\nkind = 'x{i}'\n" for i in range(990)), "solver[1].kind: unknown solver 'x0'", "… and 940 more"),
    "a million methods": (
        VALID + "".join(f"[[solver]]\nkind = 'de'\npopulation = {i + 60}\n[[formulation]]\nkind = 'nemo'\nalpha = {i + 1.5}\n" for i in range(990)),
        "at most 10,000 methods, got 991 [[formulation]] × 991 solvers = 982,081",
    ),
    "too many values": (with_("snr_db = 20.0", f"snr_db = [{'1, ' * 60_000}]"), "at most 50,000 values, got 60,0"),
    "too many bytes": (VALID + "#" * 3_000_000, "at most 1,000,000 bytes"),
    "a sweep of a million points": (VALID + f"[sweep]\nsnr_db = {[*range(1000)]}\nsources = {[*range(1000)]}", "at most 10,000 points, got 1,000 × 1,000 = 1,000,000"),
    "a sweep of 2^90 points": (VALID + "[sweep]\n" + "".join(f"k{i} = [1, 2]\n" for i in range(90)), "at most 10,000 points", "= about 10^27"),
    "20,000 swept keys": (VALID + "[sweep]\n" + "".join(f"k{i} = [1]\n" for i in range(20_000)), "at most 100 keys, got 20,000"),
    "9,000 wrong swept values": (VALID + f"[sweep]\nsnr_db = {['x'] * 9000}", "sweep.snr_db[0]: expected number or list, got 'x'", "… and 51 more"),
    "9,000 equal swept values": (VALID + f"[sweep]\nsnr_db = {[1] * 9000}", "sweep.snr_db[1]: gives the same scenario as sweep.snr_db[0]"),
    "a large scenario at many points": (custom(f"positions = {[[0, i, 0] for i in range(9000)]}") + f"[sweep]\nsnr_db = {[*range(900)]}", "at most 5,000,000 values in all points"),
    # sizes of what a run allocates
    "elements = 10^12": (with_("elements = 16", "elements = 1_000_000_000_000"), "array.elements: expected less than or equal to 100000, got 1000000000000"),
    "columns × rows": (with_('"ula", elements = 16', '"upa", columns = 100000, rows = 100000'), "at most 100,000 elements, got 100000 × 100000 = 10,000,000,000"),
    "a large circle": (with_('"ula", elements = 16, spacing', '"uca", elements = 1000000, radius'), "array.elements"),
    "snapshots = 10^9": (with_("snapshots = 20", "snapshots = 1_000_000_000"), "scenario.snapshots: expected less than or equal to 100000000"),
    "snapshots × elements": (with_("snapshots = 20", "snapshots = 10_000_000"), "scenario.snapshots: expected at most 100,000,000 numbers", "snapshots × elements = 10,000,000 × 16"),
    "snapshots under fading": (with_("snapshots = 20", "snapshots = 4_000_000\nrician_k = 1.0\nfading = 'snapshot'"), "snapshots × elements × sources = 4,000,000 × 16 × 2"),
    "scatterers": (with_("snapshots = 20", "snapshots = 20\nnlos = { kind = 'clusters', scatterers = 100000, clusters = 1000 }"), "scenario.nlos: expected at most 100,000,000 numbers"),
    "sources = 10^6": (with_("sources = 2", "sources = 1_000_000"), "scenario.sources: expected less than or equal to 1000, got 1000000"),
    "sources far apart": (with_("sources = 2", "sources = 900\nmin_separation_deg = 0.2").replace("elements = 16", "elements = 1000"), "scenario.min_separation_deg: expected room for 900 sources in azimuths from"),
    "snr_db = 1e300": (with_("20.0", "1e300"), "scenario.snr_db: expected less than or equal to 300"),
    "range_m to 1e300": (with_("0.2]", "1e300]"), "scenario.range_m: expected an interval within [1e-09, 1e+09]"),
    "wavelength_m = 1e-300": (with_("= 0.02", "= 1e-300"), "scenario.wavelength_m: expected greater than or equal to"),
    "positions of 1e308 m": (custom("positions = [[1e308, 0, 0], [0, -1e308, 0], [0, 0, 1]]"), "within ±1e+09 m, got 1e+308 m"),
    # counts of runs and limits of a run
    "repetitions = 10^19": (with_("repetitions = 2", "repetitions = 10_000_000_000_000_000_000"), "repetitions: expected an integer between -2^63 and 2^63 - 1, got one of 64 bits"),
    "repetitions = 10^18": (with_("repetitions = 2", "repetitions = 1_000_000_000_000_000_000"), "repetitions: expected at most 1,000,000,000 runs, got 1,000,000,000,000,000,000 scenes × 1 points × 1 methods"),
    "seed = 2^63": (with_("seed = 1", "seed = 9223372036854775808"), "seed: expected an integer"),
    "evaluations = 2^63 - 1": (with_("= 100", "= 9223372036854775807"), "budget.evaluations: expected less than or equal to 1000000000000000, got"),
    "seconds = inf": (VALID + "seconds = inf", "budget.seconds: expected less than or equal to 1000000000, got inf"),
    "target = -inf": (VALID + "target = -inf", "budget.target: expected a finite number or a table with gap, error or error_in_bounds, got -inf"),
    "run_memory_mb = 1e13": (VALID + "run_memory_mb = 1e13", "budget.run_memory_mb: expected integer, got 10000000000000.0"),
    "outlier_m = inf": (VALID + "[summary]\noutlier_m = inf", "summary.outlier_m: expected less than inf, got inf"),
    # types
    "a date": (with_("snr_db = 20.0", "snr_db = 2024-01-01"), "scenario.snr_db: expected a number, text, list or table, got the date or time 2024-01-01"),
    "a time": (with_("seed = 1", "seed = 07:32:00"), "seed: expected a number, text, list or table, got the date or time 07:32:00"),
    "a date and time": (VALID + "x = [1979-05-27T07:32:00Z]", "budget.x[0]: expected"),
    "a kind that is a list": (with_('kind = "ula"', 'kind = ["ula"]'), "scenario.array.kind: unknown kind ['ula']; known: ula"),
    "a kind that is a table": (with_('kind = "de"', "kind = { a = 1 }"), "solver[0].kind: expected a string, got {'a': 1}"),
    "a deep table for a number": (with_("sources = 2", "sources = " + "{a=" * 25 + "1" + "}" * 25), "scenario.sources: expected integer, got {'a': {'a': {"),
    "a deep list for a number": (with_("= 0.02", "= " + "[" * 25 + "]" * 25), "scenario.wavelength_m: expected number, got [[["),
    "a list for [scenario]": (with_("[scenario]", "[[scenario]]"), "scenario: expected table, got ["),
    "a text for [sweep]": ("sweep = 'x'\n" + VALID, "sweep: expected table, got 'x'"),
    "numbers for [[solver]]": (with_('[[solver]]\nkind = "de"', "").replace("seed", "solver = [1]\nseed"), "solver[0]: expected table, got 1"),
    "a label that is a list": (with_('kind = "de"', 'kind = "de"\nlabel = ["a"]'), "solver[0].label: expected a non-empty string, got ['a']"),
    # sweeps
    "a swept table that does not exist": (VALID + "[sweep]\n'antenna.elements' = [1]", "sweep.antenna.elements[0]: antenna: unknown option; known: array"),
    "a swept table below one": (VALID + "[sweep]\n'array.foo.bar' = [1]", "sweep.array.foo.bar[0]: array.foo: unknown option; known: elements"),
    "a swept option of a table that is not given": (VALID + "[sweep]\n'nlos.clusters' = [1]", "sweep.nlos.clusters[0]: nlos.kind: is required"),
    "equal swept values": (VALID + "[sweep]\nsnr_db = [1, 1.0]", "sweep.snr_db[1]: gives the same scenario as sweep.snr_db[0]"),
    "a key that is swept twice": (VALID + "[sweep]\n'array.elements' = [8]\n[sweep.array]\nelements = [9]", "sweep.array.elements: is given twice"),
    "a swept nan": (VALID + "[sweep]\nsnr_db = [1, nan]", "sweep.snr_db[1]: expected a number, got nan"),
    # text
    "a text of 500,000 characters": (with_('name = "s"', f'name = "{"s" * 500_000}"'), "name: expected at most 10,000 characters, got 500,000"),
    "a kind of 9,000 characters": (with_('kind = "de"', f'kind = "{"s" * 9000}"'), "solver[0].kind: unknown solver 'sss"),
    "a key with an escape character": (VALID + '"a\\u001bb" = 1', "budget: expected keys without control characters, got 'a\\x1bb'"),
    "an escape character": ('title = "a\\u001b[31m"\n' + VALID, "title: expected text without control characters, got '\\x1b'"),
    "a character that turns the line": ('title = "a\\u202eb"\n' + VALID, "title: expected text without control characters"),
    # files
    "a plugin with a null character": ('plugins = ["a\\u0000b"]\n' + VALID, "plugins[0]: expected text without control characters"),
    "a plugin with a long name": (f'plugins = ["{"a" * 5000}.py"]\n' + VALID, "plugins: plugin file", "File name too long"),
    "a plugin that is a folder": ('plugins = ["/tmp"]\n' + VALID, "plugin file /tmp: expected a regular file, got a folder"),
    "a plugin that is a device": ('plugins = ["/dev/zero"]\n' + VALID, "plugin file /dev/zero: expected a regular file"),
    "an array file that is a device": (custom("file = '/dev/zero'"), "expected a regular file, got a folder or device: /dev/zero"),
    "an array file with a long name": (custom(f"file = '{'a' * 5000}'"), "array.file: cannot be read: File name too long"),
    # what is no manifest at all
    "an empty file": ("", "is empty: expected at least name, scenes, seed, [scenario] and [[formulation]]"),
    "only comments": ("# nothing\n\n", "is empty"),
    "UTF-16": (VALID.encode("utf-16"), "expected UTF-8, got the byte 0xff in line 1; save the file in the encoding UTF-8"),
    "a byte that is not UTF-8": (VALID.encode() + b"\xff", "expected UTF-8, got the byte 0xff in line 19"),
    "null bytes": (b"\0" * 500_000, "is not valid TOML"),
    "unclosed texts": ('x = "' + '\\"' * 400_000, "is not valid TOML: Unterminated string"),
    "quotes in quotes": ("x = " + "'\"" * 300_000, "is not valid TOML"),
    "triple quotes": ('"""' * 300_000, "is not valid TOML"),
    "words": ("a.b " * 200_000, "is not valid TOML"),
    "equals signs": ("=" * 900_000, "at most 50,000 values"),
}  # fmt: skip

VALUES = [
    *("nan", "inf", "-inf", "1e308", "-1", "0", "1", "3.5", "9223372036854775807", "10_000_000_000_000_000_000"),
    *("true", "''", "'x'", "'NA'", '"\\u001b"', "[]", "{}", "[[]]", "[1, 2]", "[nan]", "[-1e308, 1e308]", "{ kind = 'de' }"),
    *("2024-01-01", "[1, 'x']", "{ a = { b = [1, { c = 2 }] } }", "'/dev/zero'", "[" * 40 + "]" * 40, "9" * 400),
]  # fmt: skip
LINES = [
    *("[sweep]\nsnr_db = [1, 2]", "[sweep]\nsources = [1, 2, 3]", "[sweep]\n'array.elements' = [8, 16]", "[summary]"),
    *("[[solver]]\ngroup = 'global'", "[[method]]\nformulation = 'music'", "[[formulation]]\nkind = 'grid-refine'"),
    *("[[solver]]\nkind = 'portfolio'", "[[solver]]\nkind = 'de'\npopulation = 60", "nlos = { kind = 'clusters' }"),
    *("[[method]]\nformulation = 'neef'\nsolver = 'de'\nlabel = '=1'", "elevation_deg = [-20, 20]", "rician_k = 10.0"),
    *("fading = 'block'", "positions = [[0, 0.1], [10, 0.1]]", "title = 'x'", "plugins = ['no.py']", "run_timeout_s = 1e7"),
]  # fmt: skip


def mutated(rng):
    """A valid manifest after one to three random changes: values, keys, lines and single bytes."""
    lines = VALID.splitlines()
    for _ in range(rng.randint(1, 3)):
        i = rng.randrange(len(lines))
        key, sign, _ = lines[i].partition("=")
        match rng.randrange(8):
            case 0 | 1 if sign:
                lines[i] = f"{key}= {rng.choice(VALUES)}"
            case 2:
                lines.insert(i, rng.choice(LINES))
            case 3:
                lines.append(rng.choice(LINES))
            case 4:
                del lines[i]
                lines = lines or ["x"]
            case 5:
                lines.insert(rng.randrange(len(lines)), lines[i])
            case 6 if sign:
                at = rng.randrange(len(lines[i]) + 1)
                lines[i] = (
                    lines[i][:at]
                    + rng.choice(["[", "{", '"', "'", "=", ".", "#", "9", "\x1b", "λ", "\x00"])
                    + lines[i][at:]
                )
            case 7 if sign:
                lines.insert(i, f"{rng.choice(['x', 'kind', 'label', 'a.b', 'seed'])} = {rng.choice(VALUES)}")
    return "\n".join(lines)


def violations(seed, count, folder):
    """Load ``count`` random manifests; return the exceptions, delays and control characters that must not occur."""
    from nfbench import ManifestError, load_study

    path, rng, found, studies = Path(folder) / "study.toml", random.Random(seed), [], 0
    path.write_text(VALID + "[[solver]]\ngroup = 'all'\n")
    load_study(path)  # imports the plugins, which takes seconds
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEGABYTES * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))
    for number in range(count):
        text = mutated(rng)
        path.write_text(text)
        start = time.perf_counter()
        try:
            load_study(path)
            studies += 1
        except ManifestError as error:
            if not all(character.isprintable() or character == "\n" for character in str(error)):
                found.append((number, "control characters", text))
        except BaseException as error:
            found.append((number, repr(error)[:200], text))
        if time.perf_counter() - start > SECONDS:
            found.append((number, "slow", text))
    return found, studies


if __name__ == "__main__":
    print(json.dumps(violations(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3])))
